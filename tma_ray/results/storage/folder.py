"""Storage in a folder, with atomic and durable writes, exclusive creation, and locks."""

import errno
import fcntl
import hashlib
import os
import shutil
import stat
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import Any, Final
from urllib.parse import unquote, urlsplit

import pyarrow as pa

from tma_ray.results.storage.base import (
    CONTINUES,
    TEMPORARY,
    ResultsRootError,
    ResultT,
    Stamp,
    StorageError,
    Store,
    Version,
)
from tma_ray.support.decoding import MOST_TEXT_BYTES, DamagedFileError, check_file, read_file
from tma_ray.support.quantities import expanded

DISK_FULL: Final = (errno.ENOSPC, errno.EDQUOT)  # error numbers of a full disk or quota

_ADVICE: Final = {
    errno.ENOSPC: "free some space there",
    errno.EDQUOT: "your quota there is used up; free some space",
    errno.EROFS: "it is mounted read-only",
    errno.EACCES: "you may not do that there",
    errno.ENOTDIR: "part of it is a file, not a folder",
    errno.ELOOP: "its symbolic links lead in a circle",
    errno.ENAMETOOLONG: "a name in it is too long",
}

_LACKS: Final = frozenset({errno.EINVAL, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EPERM})
"""Error numbers of operations that a file system lacks or forbids."""

_NO_SYNC: Final = (_LACKS | {errno.EACCES, errno.EBADF, errno.EISDIR}) - {errno.EPERM}
"""Error numbers to ignore when opening or syncing a folder, as in PostgreSQL."""

CHECKOUT: Final = (".git", "pyproject.toml")  # files in the top folder of a source checkout

LOCK_SECONDS: Final = 5.0  # longest wait for another process's lock, s
FILE_ENDINGS: Final = (".json", ".parquet", ".safetensors", ".log")  # suffixes of files, never of folders


class FolderStore(Store, schemes=("", "file")):
    """Store in a folder; files are written under temporary names, synced and renamed.

    Symbolic links out of the root are never followed. Folders are renamed to temporary paths before deletion.
    """

    @classmethod
    def at(cls, uri: str) -> "FolderStore":
        path = unquote(urlsplit(uri).path) if uri.startswith("file://") else uri
        return cls(expanded(path).absolute().as_posix())

    def __str__(self) -> str:
        return self.base

    def _read(self, path: str, most_bytes: int) -> bytes:
        self._refuse_links_out(path)
        with explained_disk(self.where(path)):
            return read_file(self.full_path(path), most_bytes)

    def _read_parts(self, path: str, read: Callable[[Any], ResultT]) -> ResultT:
        self._refuse_links_out(path)
        with explained_disk(self.where(path)):
            check_file(self.full_path(path))
            with pa.OSFile(self.full_path(path)) as file:
                return read(file)

    def read_version(self, path: str) -> tuple[bytes, Version]:
        data = self._read(path, MOST_TEXT_BYTES)
        return data, hashlib.sha256(data).hexdigest()

    def write_bytes(self, path: str, data: bytes) -> None:
        target = self._checked_path(path)
        with explained_disk(self.where(path)):
            write_file(target, self._aside(), data)

    def create(self, path: str, data: bytes) -> bool:
        """Write a new file through a hard link to a temporary one, or return False if the file exists."""
        target = self._checked_path(path)
        with explained_disk(self.where(path)):
            return write_file(target, self._aside(), data, exclusive=True)

    def replace(self, path: str, data: bytes, version: Version) -> bool:
        with explained_disk(self.where(path)), locked_folder(Path(self.base)):
            try:
                if self.read_version(path)[1] != version:
                    return False
            except FileNotFoundError:
                return False
            self.write_bytes(path, data)
            return True

    def exists(self, path: str) -> bool:
        with explained_disk(self.where(path)):
            return Path(self.full_path(path)).is_file()

    def holds(self, path: str) -> bool:
        return os.path.lexists(self.full_path(path))

    def _stamps(self, folder: str = "") -> dict[str, Stamp]:
        full = self.full_path(folder) if folder else self.base
        self._refuse_links_out(folder)
        with explained_disk(self.where(folder)), suppress(FileNotFoundError):
            return dict(sorted(stamps_below(self.base, full or "/")))
        return {}

    def _names(self, folder: str) -> set[str]:
        full = self.full_path(folder) if folder else self.base
        with explained_disk(self.where(folder)), suppress(FileNotFoundError, NotADirectoryError):
            return set(os.listdir(full))  # noqa: PTH208 - thousands of names
        return set()

    def move(self, source: str, destination: str) -> None:
        old, new = self._checked_path(source), self._checked_path(destination)
        with explained_disk(self.where(source)):
            make_folder(new.parent)
            old.replace(new)
            sync_folder(new.parent)
            sync_folder(old.parent)

    def delete(self, path: str) -> None:
        """Delete a file, a link (not its target), or a folder, even while others write to it."""
        target = self._checked_path(path)
        with explained_disk(self.where(path)):
            if target.is_dir() and not target.is_symlink():
                target = target.replace(self._aside())
            delete(target)

    def check_location(self, *folders: str) -> None:
        with explained_disk(self.where("")):
            folder = Path(os.path.realpath(self.base))  # raises no error for circular links
            problem = ""
            if folder == Path(folder.anchor):
                problem = "the root of the file system"
            elif folder == Path(os.path.expanduser("~")).resolve():  # noqa: PTH111 - some users have no home
                problem = "your home folder"
            elif any((folder / name).exists() for name in CHECKOUT):
                problem = "the top of a source checkout"
            if problem:
                raise ResultsRootError(
                    f"{self} is {problem}: results need a folder of their own, such as {folder / 'results'}"
                )
        for name in folders:
            self._refuse_links_out(name)

    def check_access(self) -> None:
        self.check_location()

    def clear_temporaries(self, older_than: float) -> None:
        self._refuse_links_out(TEMPORARY)
        for name in sorted(self._names(TEMPORARY)):
            if self.is_temporary(f"{TEMPORARY}/{name}"):
                file = Path(self.base, TEMPORARY, name)
                with suppress(FileNotFoundError):  # its writer has already renamed it
                    if time.time() - file.lstat().st_mtime > older_than:
                        delete(file)

    def temporary(self) -> str:
        """Return a new path for a temporary file, marked with the root's inode, and create its folder."""
        self._refuse_links_out(TEMPORARY)
        make_folder(Path(self.base, TEMPORARY))
        return super().temporary()

    def _mark(self) -> str:
        return f"tma_ray-{Path(self.base).stat().st_ino}-"

    def _refuse_links_out(self, path: str) -> None:
        """Raise a DamagedFileError for symbolic links that lead out of the root."""
        if links_out(self.base, path):
            raise DamagedFileError(
                f"{self.where(path)} is damaged: a symbolic link leads out of the root or nowhere"
            )

    def _checked_path(self, path: str) -> Path:
        """Return the full path after checking that its folder is inside the root."""
        full = self.full_path(path)
        self._refuse_links_out(str(PurePosixPath(path).parent))
        return Path(full)

    def _aside(self) -> Path:
        return Path(self.full_path(self.temporary()))


@contextmanager
def explained_disk(where: str, kinds: Collection[int] | None = None) -> Iterator[None]:
    """Context manager that converts operating-system errors into a StorageError with `where` and a remedy.

    Args:
        where: name of the file or folder.
        kinds: error numbers to convert, None for all.

    Raises:
        FileNotFoundError: if it is missing (unchanged).
        DamagedFileError: if there is a folder instead of the file.
        StorageError: for other errors of these kinds.
    """
    try:
        yield
    except (FileNotFoundError, StorageError):
        raise
    except IsADirectoryError as error:  # retrying does not help
        raise DamagedFileError(f"{where} is damaged: a folder lies in its place") from error
    except OSError as error:
        if kinds is not None and error.errno not in kinds:
            raise
        if error.errno in _LACKS:  # retrying does not help
            raise StorageError(
                f"{where}: its file system lacks an operation that results need ({error}); use a folder on "
                f"another one"
            ) from error
        advice = _ADVICE.get(error.errno or 0, "the disk refuses it")
        raise StorageError(f"{where}: {advice} ({error}); {CONTINUES}") from error


def write_file(target: Path, temporary: Path, data: bytes, *, exclusive: bool = False) -> bool:
    """Write `target` atomically by renaming `temporary`; return False if `exclusive` and `target` exists."""
    make_folder(target.parent)
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        if exclusive:
            _name_exclusively(temporary, target)
        else:
            temporary.replace(target)
    except FileExistsError:
        return False
    finally:
        temporary.unlink(missing_ok=True)
    sync_folder(target.parent)
    return True


def _name_exclusively(temporary: Path, target: Path) -> None:
    """Give the file `temporary` the name `target`, or raise a FileExistsError if `target` exists.

    On file systems without hard links (FAT, exFAT, SMB, many in user space) an empty file is created first,
    and replaced under the lock of the folder.
    """
    try:
        target.hardlink_to(temporary)
    except FileExistsError:
        raise
    except OSError:
        with locked_folder(target.parent):
            target.touch(exist_ok=False)
            try:
                temporary.replace(target)
            except OSError:
                target.unlink()
                raise


@contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Context manager that locks a folder, creating it if it is missing.

    Without locks in the file system, or after `LOCK_SECONDS`, the block is entered without a lock.
    """
    make_folder(folder)
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        deadline = time.monotonic() + LOCK_SECONDS
        with suppress(OSError):  # the file system has no locks
            while time.monotonic() < deadline:
                try:
                    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                except BlockingIOError:
                    time.sleep(0.005)
        yield
    finally:
        os.close(descriptor)


def make_folder(folder: Path) -> None:
    """Create a folder and its parents, and sync them to disk."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    for path in reversed(missing):
        path.mkdir(exist_ok=True)
        sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Sync a folder's entries to disk if the file system supports it."""
    try:
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
    except OSError as error:
        if error.errno not in _NO_SYNC:
            raise


def links_out(base: str, path: str) -> bool:
    """Return True if a symbolic link in `path` leads out of `base` or is broken."""
    target, linked = base, False
    for part in path.split("/"):
        target = f"{target}/{part}"
        linked = linked or os.path.islink(target)  # noqa: PTH114 - five times as fast, for thousands of files
    if not linked:
        return False
    try:
        os.stat(target)  # noqa: PTH116 - as above
    except OSError as error:
        if error.errno == errno.ELOOP:  # Path.resolve ignores it from Python 3.13 on
            return True
    return not Path(target).resolve().is_relative_to(Path(base).resolve())


def stamps_below(base: str, folder: str) -> Iterator[tuple[str, Stamp]]:
    """Yield the path (relative to `base`) and the `Stamp` of each file below `folder`.

    Stamps are empty for other entries: pipes, sockets and devices, broken or circular links, links out of
    `base`, folders named like files, and unreadable folders.
    """
    with os.scandir(folder) as entries:
        for entry in entries:
            path = entry.path[len(base) + 1 :]
            try:
                status = entry.stat()
            except OSError as error:
                if entry.is_symlink() or not isinstance(
                    error, FileNotFoundError
                ):  # a concurrent deletion is not an error
                    yield path, (None, None)
                continue
            if stat.S_ISREG(status.st_mode):
                yield path, (status.st_mtime_ns, status.st_size)
            elif not stat.S_ISDIR(status.st_mode) or (
                entry.is_symlink()
                and (
                    links_out(base, path) or Path(folder).resolve().is_relative_to(Path(entry.path).resolve())
                )
            ):
                yield path, (None, None)
            else:
                if path.endswith(FILE_ENDINGS):
                    yield path, (None, None)
                try:
                    yield from stamps_below(base, entry.path)
                except FileNotFoundError:  # another process has deleted it
                    continue
                except OSError:
                    yield path, (None, None)


def delete(path: Path) -> None:
    """Delete a file, a link (not its target), or as much of a folder as possible."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(FileNotFoundError, NotADirectoryError):
            path.unlink()
