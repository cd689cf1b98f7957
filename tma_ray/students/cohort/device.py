"""The device of a learner: execution of updates, random numbers by counter, copies from and to it."""

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
"""Options of glibc's mallopt: bytes that are free before they go back, and bytes that are mapped apart."""


def empty(shape: tuple[int, ...], dtype: torch.dtype, device: torch.device) -> torch.Tensor:
    """Return zeros; a CPU gives pages for them only when they are written to."""
    if device.type == "cpu":
        kind = torch.empty(0, dtype=dtype).numpy().dtype
        return torch.from_numpy(np.zeros(shape, dtype=kind))
    return torch.zeros(shape, dtype=dtype, device=device)


def upload(values: NDArray[Any], device: torch.device) -> torch.Tensor:
    """Return `values` on `device`; on a CPU they may share memory."""
    tensor = torch.from_numpy(np.ascontiguousarray(values))
    if device.type == "cpu":
        return tensor
    return tensor.pin_memory().to(
        device, non_blocking=True
    )  # torch keeps the pinned memory until it was read


def keep_pages() -> None:
    """Make the C library keep freed memory, if it can: new pages for each update take a fifth of its time."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_TRIM_THRESHOLD, 2**31 - 1)
        mallopt(_MAP_THRESHOLD, 2**25)  # the most that it takes


WARM_UP = 3  # executions before a graph is captured, for libraries that make what they need at first use

COMPILE_MODE = "max-autotune-no-cudagraphs"
"""Of torch's compiler: puts what is between products into them, and leaves the capture to us."""


MOST_LEARNERS = 128
"""Sizes that a function is compiled for in one process; beyond, torch would execute it uncompiled."""


@contextmanager
def precision(chosen: MatmulPrecision) -> Iterator[None]:
    """Has torch multiply float32 matrices in the precision `chosen`; casts to bfloat16 are explicit."""
    outside = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("high" if chosen == MatmulPrecision.HIGH else "highest")
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(outside)


def hidden_type(chosen: MatmulPrecision, dtype: torch.dtype) -> torch.dtype:
    """Return the type of hidden layers where parameters are of `dtype`."""
    return torch.bfloat16 if chosen == MatmulPrecision.MEDIUM else dtype


def compile_if(wanted: bool | str, function: Callable[..., Any]) -> Callable[..., Any]:
    """Return `function`, compiled by torch if that is `wanted`; a string is the compiler's mode."""
    if not wanted:
        return function
    from torch._dynamo import config  # 2 s and 150 MB, which learners that compile nothing are spared

    config.recompile_limit = max(config.recompile_limit, MOST_LEARNERS)
    return torch.compile(function, mode=COMPILE_MODE if wanted is True else wanted, dynamic=False)


class Repeated:
    """A function that is executed many times, each time on the same memory.

    On a GPU it is captured as a graph: nothing of it may depend on numbers of the host.
    """

    def __init__(self, function: Callable[[], None], chosen: MatmulPrecision, device: torch.device) -> None:
        self._function, self._precision, self._device = function, chosen, device
        self._graph: torch.cuda.CUDAGraph | None = None
        if device.type == "cpu":
            keep_pages()

    def __call__(self, times: int) -> None:
        """Execute the function `times` times; a GPU is not waited for."""
        if self._graph is not None:
            for _ in range(times):
                self._graph.replay()
            return
        with precision(self._precision):
            for _ in range(times):
                self._function()

    def forget(self) -> None:
        """Drop the graph: the function's memory is about to move."""
        self._graph = None

    @property
    def wants_capture(self) -> bool:
        """True if the next execution should be preceded by `capture`."""
        return self._device.type == "cuda" and self._graph is None

    def capture(self) -> None:
        """Capture the graph, for which the function is executed a few times."""
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
    """Purpose of random numbers; those of different purposes are independent."""

    BATCH = 0  # transitions of a batch
    NOISE = 1  # of actions in an update


def words_of(number: int) -> tuple[int, int]:
    """Return the low and the high 32 bits of a `number` of 64 bits."""
    return number & _WORD, number >> 32 & _WORD


def philox(counters: tuple[torch.Tensor, ...], keys: tuple[torch.Tensor, torch.Tensor]) -> torch.Tensor:
    """Return four random words for each counter, in a new last axis (..., 4).

    Counters are four words, least significant first, keys two; all broadcast with one another (...).
    """
    c0, c1, c2, c3 = counters
    k0, k1 = keys
    for _ in range(ROUNDS):
        (high0, low0), (high1, low1) = (_product(c, m) for c, m in zip((c0, c2), _MULTIPLIERS, strict=True))
        c0, c1, c2, c3 = high1 ^ c1 ^ k0, low1, high0 ^ c3 ^ k1, low0
        k0, k1 = (k0 + _KEY_STEPS[0]) & _WORD, (k1 + _KEY_STEPS[1]) & _WORD
    return torch.stack((c0, c1, c2, c3), dim=-1)


def words(keys: torch.Tensor, numbers: torch.Tensor, purpose: Purpose, count: int) -> torch.Tensor:
    """Return random words (k, count) for the update `numbers` (k,) of runs with `keys` (k, 2)."""
    blocks = torch.arange(-(-count // 4), device=keys.device)
    low, high = (numbers & _WORD)[:, None], (numbers >> 32 & _WORD)[:, None]
    # the block is the second word, which no round multiplies: torch's compiler would do that in 32 bits
    counters = low, blocks, high, torch.full_like(low, int(purpose))
    drawn = philox(counters, (keys[:, :1], keys[:, 1:])).flatten(1)
    return drawn[:, :count]


def integers_below(limits: torch.Tensor, drawn: torch.Tensor) -> torch.Tensor:
    """Return integers (k, n) in [0, limit) from random words `drawn` (k, n); `limits` (k,) are under 2^31.

    A number is at most 2^-32 more or less likely than it should be.
    """
    return drawn * limits[:, None] >> 32


def standard_normals(drawn: torch.Tensor, dtype: torch.dtype) -> torch.Tensor:
    """Return standard normals (k, n) from random words `drawn` (k, n), n even (Box and Muller)."""
    halves = drawn.view(len(drawn), -1, 2).to(dtype)
    radii = (-2 * ((halves[..., 0] + 1) * 2.0**-32).log()).sqrt()
    angles = halves[..., 1] * (2 * math.pi * 2.0**-32)
    return torch.stack((radii * angles.cos(), radii * angles.sin()), dim=-1).flatten(1)


def _product(word: torch.Tensor, multiplier: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the high and the low word of a product of 32-bit words, computed from 16-bit halves.

    Signed numbers of 64 bits would overflow, which compilers of C++ assume never to happen.
    """
    lower, upper = (word & 0xFFFF) * multiplier, (word >> 16) * multiplier
    upper = upper + (lower >> 16)
    return upper >> 16, (upper & 0xFFFF) << 16 | lower & 0xFFFF
