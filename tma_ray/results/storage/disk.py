"""Files of a disk: written durably and whole, made exclusively, guarded by locks of the system."""

from __future__ import annotations

import fcntl
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from tma_ray.results.storage.errors import ResultsRootError

CHECKOUT: Final = (".git", "pyproject.toml")
"""Names of which the top folder of a source checkout has one."""

LOCK_SECONDS: Final = 5.0
"""How long to wait for a lock that another process keeps, which may be frozen, s."""

LOCK_PAUSE: Final = 0.005
"""Between two tries to get it, s."""


def write_file(target: Path, temporary: Path, data: bytes, *, exclusive: bool = False) -> bool:
    """Writes a file by way of a `temporary` one, atomically and durably.

    Args:
        target: where to.
        temporary: a name in an existing folder of the same file system; nothing is left there.
        data: the content.
        exclusive: only if the file does not exist yet.

    Returns:
        False if it was to be new and is not.
    """
    make_folder(target.parent)
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        if exclusive:
            target.hardlink_to(temporary)
        else:
            temporary.replace(target)
    except FileExistsError:
        return False
    finally:
        temporary.unlink(missing_ok=True)
    sync_folder(target.parent)
    return True


@contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Keeps other processes out of blocks under the lock of the same folder, which is made if need be.

    The lock ends with its process. Where the file system has none, or it is not to be had for `LOCK_SECONDS`,
    the block is entered without.
    """
    make_folder(folder)
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        _lock(descriptor)
        yield
    finally:
        os.close(descriptor)


def make_folder(folder: Path) -> None:
    """Makes a folder and its parents durably: each new name is synced in the folder that holds it."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    for path in reversed(missing):
        path.mkdir(exist_ok=True)
        sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Makes the names in a folder survive a crash of the machine."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _lock(descriptor: int) -> None:
    """Locks an open folder, unless its file system has no locks or another process keeps it too long."""
    deadline = time.monotonic() + LOCK_SECONDS
    while time.monotonic() < deadline:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(LOCK_PAUSE)
        except OSError:
            return
        else:
            return


def links_out(base: str, path: str) -> bool:
    """Tells whether a symbolic link between the folder `base` and `path` leads out of it, or nowhere."""
    place, linked = base, False
    for part in path.split("/"):
        place = f"{place}/{part}"
        linked = linked or os.path.islink(place)  # noqa: PTH114 - five times as fast, for thousands of files
    if not linked:
        return False
    try:
        return not Path(place).resolve().is_relative_to(Path(base).resolve())
    except (OSError, RuntimeError):  # a circle
        return True


def refuse_place(folder: Path) -> None:
    """Refuses a folder that holds more than results.

    Raises:
        ResultsRootError: it is the root of the file system, the user's home, or the top of a source checkout.
    """
    place = Path(os.path.realpath(folder))  # no error of links in a circle
    if place == Path(place.anchor):
        problem = "the root of the file system"
    elif place == Path(os.path.expanduser("~")).resolve():  # noqa: PTH111 - some users have no home
        problem = "your home folder"
    elif any((place / name).exists() for name in CHECKOUT):
        problem = "the top of a source checkout"
    else:
        return
    raise ResultsRootError(
        f"{folder} is {problem}: results need a folder of their own, such as {place / 'results'}"
    )


def delete(path: Path) -> None:
    """Deletes a file, a link but not its target, or as much of a folder as can be; fine if there is none."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(FileNotFoundError, NotADirectoryError):
            path.unlink()
