"""Compiles the kernels, which stay plain Python under ``NUMBA_DISABLE_JIT=1``."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])


def kernel(function: F) -> F:
    """Returns `function` compiled on its first call and cached on disk.

    Kernels use arithmetic and comparisons only, neither transcendental functions nor fast-math: compiled and
    plain they give the same bits.
    """
    compiled: Any = numba.njit(cache=True)(function)
    if compiled is not function:
        # numba notices changes of the function's own file only, but kernels call each other across files.
        compiled._cache._cache_file._source_stamp = _sources()
    return cast("F", compiled)


@cache
def _sources() -> str:
    """Returns a digest of every file that a kernel may be in."""
    content = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        content.update(path.read_bytes())
    return content.hexdigest()
