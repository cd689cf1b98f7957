"""Compilation of kernels by numba, unless ``NUMBA_DISABLE_JIT=1`` is set."""

import hashlib
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import event

from tma_ray.support.interrupts import is_command

F = TypeVar("F", bound=Callable[..., object])


class _Announcer(event.Listener):
    """Event listener that announces the first compilation."""

    def on_start(self, event: Any) -> None:  # noqa: ARG002 - numba's signature
        _announce()

    def on_end(self, event: Any) -> None:
        """Do nothing."""


@cache
def _announce() -> None:
    sys.stderr.write(
        "tma-ray: compiling kernels, once per machine and version; it takes up to half a minute\n"
    )


if is_command(sys.orig_argv):
    event.register("numba:compile", _Announcer())  # type: ignore[no-untyped-call]


def kernel(function: F, nogil: bool = False) -> F:
    """Return `function` compiled on its first call, without fast-math, and cached on disk.

    Kernels of physics and terrains avoid transcendental functions, so that plain Python gives the same bits.

    Args:
        function: the kernel.
        nogil: True to release the GIL during calls.

    Raises:
        OSError: if no cache folder is writable.
    """
    try:
        # inlined, since a call with arrays takes longer than most kernels
        compiled: Any = numba.njit(cache=True, forceinline=True, nogil=nogil)(function)
    except RuntimeError as error:
        raise OSError(
            f"compiled kernels cannot be kept: neither the folder of {function.__code__.co_filename} nor the "
            f"user's own cache may be written; name a folder that may be in NUMBA_CACHE_DIR"
        ) from error
    if compiled is not function:
        # numba only checks the function's own file for changes, but kernels call kernels in other files, so
        # the sources of the package become part of the cache's version; numba also discards an index of
        # another version before unpickling it, which would fail on types of deleted modules
        file = Path(function.__code__.co_filename)
        compiled._cache._cache_file._version = (numba.__version__, _sources(_package(file)))
    return cast("F", compiled)


def _package(file: Path) -> Path:
    """Return the folder of the top-level subpackage that contains `file`, or of `file` if there is none."""
    folder = file.parent
    while (folder.parent.parent / "__init__.py").is_file():
        folder = folder.parent
    return folder


@cache
def _sources(folder: Path) -> str:
    """Return a digest of the names and contents of the Python files in `folder`."""
    content = hashlib.sha256()
    is_package = (folder / "__init__.py").is_file()  # never recurse into other folders, such as a home folder
    for path in sorted(folder.glob("**/*.py" if is_package else "*.py")):
        content.update(f"{path.relative_to(folder)}\0".encode() + path.read_bytes())
    return content.hexdigest()
