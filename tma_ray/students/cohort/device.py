"""Utilities for GPUs and CPUs: repeated execution, counter-based random numbers and copies."""

import ctypes
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import IntEnum
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from tma_ray.students.hyperparameters import MatmulPrecision

_TRIM_THRESHOLD, _MAP_THRESHOLD = -1, -3
"""Options M_TRIM_THRESHOLD and M_MMAP_THRESHOLD of glibc's mallopt."""


def empty(shape: tuple[int, ...], dtype: torch.dtype, device: torch.device) -> torch.Tensor:
    """Return a tensor of zeros; on a CPU, memory pages are allocated only when first written."""
    if device.type == "cpu":
        kind = torch.empty(0, dtype=dtype).numpy().dtype
        return torch.from_numpy(np.zeros(shape, dtype=kind))
    return torch.zeros(shape, dtype=dtype, device=device)


def upload(values: NDArray[Any], device: torch.device) -> torch.Tensor:
    """Return `values` as a tensor on `device`; a tensor on a CPU may share memory with `values`."""
    tensor = torch.from_numpy(np.ascontiguousarray(values))
    if device.type == "cpu":
        return tensor
    return tensor.pin_memory().to(device, non_blocking=True)  # torch keeps pinned memory until the copy ends


def keep_pages() -> None:
    """Make glibc keep freed memory, since requesting new pages takes a fifth of an update's time."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_TRIM_THRESHOLD, 2**31 - 1)
        mallopt(_MAP_THRESHOLD, 2**25)  # largest threshold that glibc allows


WARM_UP = 3  # executions before the capture of a graph, to initialise libraries

COMPILE_MODE = "max-autotune-no-cudagraphs"  # without CUDA graphs, which `Repeated` captures
MOST_SHAPES = 128  # largest number of shapes for which torch compiles a function in one process


@contextmanager
def precision(chosen: MatmulPrecision) -> Iterator[None]:
    """Context manager that sets torch's float32 matmul precision.

    For `MatmulPrecision.MEDIUM`, learners cast hidden layers to bfloat16 themselves.
    """
    previous = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("high" if chosen == MatmulPrecision.HIGH else "highest")
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(previous)


def hidden_type(chosen: MatmulPrecision, dtype: torch.dtype) -> torch.dtype:
    """Return the data type of hidden layers at the `chosen` precision, for parameters of `dtype`."""
    return torch.bfloat16 if chosen == MatmulPrecision.MEDIUM else dtype


def compile_if(mode: bool | str, function: Callable[..., Any]) -> Callable[..., Any]:
    """Return `function`, compiled by torch if `mode` is True or the name of a compiler mode."""
    if not mode:
        return function
    from torch._dynamo import config  # deferred, since the import takes 2 s and 150 MB

    config.recompile_limit = max(config.recompile_limit, MOST_SHAPES)
    return torch.compile(function, mode=COMPILE_MODE if mode is True else mode, dynamic=False)


class Repeated:
    """Wrapper of a function that is executed many times on the same memory, on a GPU as a CUDA graph.

    The function must not depend on values in host memory.
    """

    def __init__(self, function: Callable[[], None], chosen: MatmulPrecision, device: torch.device) -> None:
        self._function, self._precision, self._device = function, chosen, device
        self._graph: torch.cuda.CUDAGraph | None = None
        if device.type == "cpu":
            keep_pages()

    def __call__(self, times: int) -> None:
        """Execute the function `times` times, without waiting for a GPU."""
        if self._graph is not None:
            for _ in range(times):
                self._graph.replay()
            return
        with precision(self._precision):
            for _ in range(times):
                self._function()

    def forget(self) -> None:
        """Discard the captured graph; required when the function's memory has moved."""
        self._graph = None

    @property
    def wants_capture(self) -> bool:
        """True if `capture` should be called before the next execution."""
        return self._device.type == "cuda" and self._graph is None

    def capture(self) -> None:
        """Capture the graph after a few warm-up executions of the function."""
        stream = torch.cuda.Stream(self._device)  # type: ignore[no-untyped-call]
        stream.wait_stream(torch.cuda.current_stream(self._device))
        graph = torch.cuda.CUDAGraph()
        with precision(self._precision):
            with torch.cuda.stream(stream):
                for _ in range(WARM_UP):
                    self._function()
            torch.cuda.current_stream(self._device).wait_stream(stream)
            torch.cuda.synchronize(self._device)
            with torch.cuda.graph(graph, stream=stream):
                self._function()
        self._graph = graph


ROUNDS = 10

_WORD = 0xFFFFFFFF
_MULTIPLIERS = 0xD2511F53, 0xCD9E8D57
_KEY_STEPS = 0x9E3779B9, 0xBB67AE85


class Purpose(IntEnum):
    """Purpose of random numbers; each purpose has its own independent stream."""

    BATCH = 0  # indices of the transitions in a batch
    NOISE = 1  # noise of actions in updates


def words_of(number: int) -> tuple[int, int]:
    """Return the low and high 32 bits of a 64-bit `number`."""
    return number & _WORD, number >> 32 & _WORD


def philox(counters: tuple[torch.Tensor, ...], keys: tuple[torch.Tensor, torch.Tensor]) -> torch.Tensor:
    """Return four random 32-bit words (..., 4) per counter, from the Philox4x32-10 generator.

    Args:
        counters: four words of the counters, least significant first, that broadcast to (...).
        keys: two words of the keys, that broadcast to (...).
    """
    c0, c1, c2, c3 = counters
    k0, k1 = keys
    for _ in range(ROUNDS):
        (high0, low0), (high1, low1) = (_product(c, m) for c, m in zip((c0, c2), _MULTIPLIERS, strict=True))
        c0, c1, c2, c3 = high1 ^ c1 ^ k0, low1, high0 ^ c3 ^ k1, low0
        k0, k1 = (k0 + _KEY_STEPS[0]) & _WORD, (k1 + _KEY_STEPS[1]) & _WORD
    return torch.stack((c0, c1, c2, c3), dim=-1)


def words(keys: torch.Tensor, numbers: torch.Tensor, purpose: Purpose, count: int) -> torch.Tensor:
    """Return random words (k, count) for k runs, determined by `keys` (k, 2) and update `numbers` (k,)."""
    blocks = torch.arange(-(-count // 4), device=keys.device)
    low, high = (numbers & _WORD)[:, None], (numbers >> 32 & _WORD)[:, None]
    # block numbers are the second word, which the first round does not multiply: torch.compile would
    # multiply them as 32-bit integers
    counters = low, blocks, high, torch.full_like(low, int(purpose))
    return philox(counters, (keys[:, :1], keys[:, 1:])).flatten(1)[:, :count]


def integers_below(limits: torch.Tensor, drawn: torch.Tensor) -> torch.Tensor:
    """Map random words `drawn` (k, n) to integers (k, n) in [0, limit), for `limits` (k,) below 2^31.

    Probabilities are off by at most 2^-32.
    """
    return drawn * limits[:, None] >> 32


def standard_normals(drawn: torch.Tensor, dtype: torch.dtype) -> torch.Tensor:
    """Map random words `drawn` (k, n), n even, to standard normal numbers (k, n) (Box-Muller transform)."""
    halves = drawn.view(len(drawn), -1, 2).to(dtype)
    radii = (-2 * ((halves[..., 0] + 1) * 2.0**-32).log()).sqrt()
    angles = halves[..., 1] * (2 * math.pi * 2.0**-32)
    return torch.stack((radii * angles.cos(), radii * angles.sin()), dim=-1).flatten(1)


def _product(word: torch.Tensor, multiplier: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the high and low words of a product of 32-bit words, without signed 64-bit overflow."""
    lower, upper = (word & 0xFFFF) * multiplier, (word >> 16) * multiplier
    upper = upper + (lower >> 16)
    return upper >> 16, (upper & 0xFFFF) << 16 | lower & 0xFFFF
