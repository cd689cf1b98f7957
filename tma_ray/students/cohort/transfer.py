"""Memory on the learner's device, and copies to it that do not wait for what the device has to do before."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

_TRIM_THRESHOLD, _MAP_THRESHOLD = -1, -3
"""Options of glibc's mallopt: bytes that are free before they go back, and bytes that are mapped apart."""


def empty(shape: tuple[int, ...], dtype: torch.dtype, device: torch.device) -> torch.Tensor:
    """Returns zeros; a CPU gives pages for them only when they are written to."""
    if device.type == "cpu":
        kind = torch.empty(0, dtype=dtype).numpy().dtype
        return torch.from_numpy(np.zeros(shape, dtype=kind))
    return torch.zeros(shape, dtype=dtype, device=device)


def upload(values: NDArray[Any], device: torch.device) -> torch.Tensor:
    """Returns `values` on `device`; on a CPU they may share memory."""
    tensor = torch.from_numpy(np.ascontiguousarray(values))
    if device.type == "cpu":
        return tensor
    return tensor.pin_memory().to(
        device, non_blocking=True
    )  # torch keeps the pinned memory until it was read


def keep_pages() -> None:
    """Has the C library keep freed memory, if it can: new pages for each update are a fifth of its time."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_TRIM_THRESHOLD, 2**31 - 1)
        mallopt(_MAP_THRESHOLD, 2**25)  # the most that it takes
