"""Execution of an update over and over: eagerly on a CPU, as a captured graph on a GPU."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import torch

from tma_ray.students.cohort.transfer import keep_pages
from tma_ray.students.hyperparameters import MatmulPrecision

WARM_UP = 3
"""Executions before a graph is captured, for libraries that make what they need at first use."""

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
    """Returns the type of hidden layers where parameters are of `dtype`."""
    return torch.bfloat16 if chosen == MatmulPrecision.MEDIUM else dtype


def compile_if(wanted: bool | str, function: Callable[..., Any]) -> Callable[..., Any]:
    """Returns `function`, compiled by torch if that is `wanted`; a string is the compiler's mode."""
    if not wanted:
        return function
    from torch._dynamo import config  # 2 s and 150 MB, which learners that compile nothing are spared

    config.recompile_limit = max(config.recompile_limit, MOST_LEARNERS)
    return torch.compile(function, mode=COMPILE_MODE if wanted is True else wanted, dynamic=False)


class Repeated:
    """A function that is executed many times, each time on the same memory.

    On a GPU it is captured as a graph: nothing of it may depend on numbers of the host.

    Args:
        function: what to execute.
        chosen: precision of its products.
        device: where it is executed.
    """

    def __init__(self, function: Callable[[], None], chosen: MatmulPrecision, device: torch.device) -> None:
        self._function, self._precision, self._device = function, chosen, device
        self._graph: torch.cuda.CUDAGraph | None = None
        if device.type == "cpu":
            keep_pages()

    def __call__(self, times: int) -> None:
        """Executes the function `times` times; a GPU is not waited for."""
        if self._graph is not None:
            for _ in range(times):
                self._graph.replay()
            return
        with precision(self._precision):
            for _ in range(times):
                self._function()

    def forget(self) -> None:
        """Drops the graph: the function's memory is about to move."""
        self._graph = None

    @property
    def wants_capture(self) -> bool:
        """True if the next execution should be preceded by `capture`."""
        return self._device.type == "cuda" and self._graph is None

    def capture(self) -> None:
        """Captures the graph, for which the function is executed a few times."""
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
