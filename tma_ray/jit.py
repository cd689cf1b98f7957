"""Compiles kernels, which stay plain Python under ``NUMBA_DISABLE_JIT=1``."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])


def kernel(function: F) -> F:
    """Returns `function` compiled on its first call, without fast-math, and cached on disk.

    Kernels of the physics and the terrains use arithmetic and comparisons only, no transcendental functions:
    compiled and plain they give the same bits.
    """
    compiled: Any = numba.njit(cache=True)(function)
    if compiled is not function:
        # numba notices changes of the function's own file only, but kernels call their folder's others.
        folder = Path(function.__code__.co_filename).parent
        compiled._cache._cache_file._source_stamp = _sources(folder)
    return cast("F", compiled)


@cache
def _sources(folder: Path) -> str:
    """Returns a digest of every file that a kernel of `folder` may be in."""
    content = hashlib.sha256()
    for path in sorted(folder.glob("*.py")):
        content.update(path.read_bytes())
    return content.hexdigest()
