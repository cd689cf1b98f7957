"""Compiles the students' kernels, which stay plain Python under ``NUMBA_DISABLE_JIT=1``."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])


def kernel(function: F) -> F:
    """Returns `function` compiled on its first call and cached on disk; without fast-math."""
    return cast("F", numba.njit(cache=True)(function))
