"""Compilation of kernels, which stay plain Python under ``NUMBA_DISABLE_JIT=1``."""

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


class _Listener(event.Listener):
    """Listener that calls functions before and after each compilation."""

    def __init__(self, before: Callable[[], None] = lambda: None, after: Callable[[], None] = lambda: None):
        self._before, self._after = before, after

    def on_start(self, event: Any) -> None:  # noqa: ARG002 - as numba asks
        self._before()

    def on_end(self, event: Any) -> None:  # noqa: ARG002
        self._after()


@cache
def _announce() -> None:
    sys.stderr.write(
        "tma-ray: compiling kernels, once per machine and version; it takes up to half a minute\n"
    )


_kernels: list[Any] = []  # kernels of the modules that have been imported


def count_compiled(show: Callable[[int, int], None]) -> None:
    """Call `show` after each compilation from now on.

    Args:
        show: function of the number of kernels that are compiled, and of all in the modules imported so far.
    """

    def count() -> None:
        show(sum(bool(each.signatures) for each in _kernels), len(_kernels))

    event.register("numba:compile", _Listener(after=count))  # type: ignore[no-untyped-call]


if is_command(sys.orig_argv):
    event.register("numba:compile", _Listener(before=_announce))  # type: ignore[no-untyped-call]


def kernel(function: F, nogil: bool = False, counted: bool = True) -> F:
    """Return `function` compiled on its first call, without fast-math, and cached on disk.

    Kernels of the physics and the terrains use arithmetic and comparisons only, no transcendental functions:
    compiled and plain they give the same bits.

    Args:
        function: the kernel.
        nogil: True if other threads of the interpreter go on during a call.
        counted: False if most processes never call it; `count_compiled` leaves it out then.

    Raises:
        OSError: no folder in which compiled kernels are kept may be written.
    """
    try:
        # Inlined: a call hands over an array as seven values, and takes longer than most kernels.
        compiled: Any = numba.njit(cache=True, forceinline=True, nogil=nogil)(function)
    except RuntimeError as error:
        raise OSError(
            f"compiled kernels cannot be kept: neither the folder of {function.__code__.co_filename} nor the "
            f"user's own cache may be written; name a folder that may be in NUMBA_CACHE_DIR"
        ) from error
    if compiled is not function:
        # numba notices changes of the function's own file only, but kernels call others of their package; it
        # unpickles an index before it compares the stamp, and so fails on types of modules that are gone.
        file = Path(function.__code__.co_filename)
        compiled._cache._cache_file._version = (numba.__version__, _sources(_package(file)))
        if counted:
            _kernels.append(compiled)
    return cast("F", compiled)


def _package(file: Path) -> Path:
    """Return the subpackage directly below the topmost package of `file`, else the file's own folder."""
    folder = file.parent
    while (folder.parent.parent / "__init__.py").is_file():
        folder = folder.parent
    return folder


@cache
def _sources(folder: Path) -> str:
    """Return a digest of every file that a kernel of `folder` may be in, with the files' names."""
    content = hashlib.sha256()
    is_package = (folder / "__init__.py").is_file()  # any other folder may be anything, a home for instance
    for path in sorted(folder.glob("**/*.py" if is_package else "*.py")):
        content.update(f"{path.relative_to(folder)}\0".encode() + path.read_bytes())
    return content.hexdigest()
