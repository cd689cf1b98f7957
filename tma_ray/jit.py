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
        # numba notices changes of the function's own file only, but kernels call others of their package.
        file = Path(function.__code__.co_filename)
        compiled._cache._cache_file._source_stamp = _sources(_package(file))
    return cast("F", compiled)


def _package(file: Path) -> Path:
    """Returns the subpackage directly below the topmost package of `file`, else the file's own folder."""
    folder = file.parent
    while (folder.parent.parent / "__init__.py").is_file():
        folder = folder.parent
    return folder


@cache
def _sources(folder: Path) -> str:
    """Returns a digest of every file that a kernel of `folder` may be in."""
    content = hashlib.sha256()
    is_package = (folder / "__init__.py").is_file()  # any other folder may be anything, a home for instance
    for path in sorted(folder.glob("**/*.py" if is_package else "*.py")):
        content.update(path.read_bytes())
    return content.hexdigest()
