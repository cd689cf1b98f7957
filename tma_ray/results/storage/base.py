"""The contract of a storage: read, write, conditional write, list and delete files below one root."""

from __future__ import annotations

import copy
import hashlib
import io
import json
import logging
import re
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final, Self, TypeAlias, TypeVar
from uuid import uuid4

import pyarrow as pa

from tma_ray.support.decoding import MOST_BYTES, MOST_TEXT_BYTES, DamagedFileError, decode_json
from tma_ray.support.validation import check_type

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

T = TypeVar("T")

Version: TypeAlias = Any  # opaque identity of a file's content, as `Store.read_version` returns it

Stamp: TypeAlias = tuple[int | None, int | None]
"""Time of writing (ns since 1970) and size (bytes) of a file; both None for anything but a file."""

TEMPORARY: Final = "tmp"
"""Folder for temporary files, outside the tables, since their readers' patterns would match it there.

Others may keep files in it: ours have names that `Store.temporary` returns.
"""

_NOT_OURS: Final = re.compile(r"(^|/)\.|^lost\+found(/|$)")
"""Names that nothing of ours has: those that begin with a dot, at any depth, and lost+found.

File managers, archives and network file systems write such files beside all others (.DS_Store, ._name, .nfs).
"""

FIRST_PAUSE: Final = 1.0  # pause before the first retry, s; doubled with every other refusal
LONGEST_PAUSE: Final = 60.0  # longest pause between two tries, s

CONTINUES: Final = "what was published before is safe, and the same command continues from there"
"""End of messages about a storage that fails."""

logger = logging.getLogger(__name__)


class ResultsRootError(ValueError):
    """Unusable results root; the message says why and what to do."""


class StorageError(OSError):
    """The storage of a results root refuses an operation; the message names the file and a remedy."""


class ObjectStoreError(StorageError, ConnectionError):
    """An object store refused a request or went on failing; the message names the file and a remedy."""


class Store(ABC):
    """Files under one root, addressed by relative paths with forward slashes.

    Others see a file whole or not at all, and what a returned call has written survives a crash. A store can
    be pickled; the other process opens an object store with credentials of its own. What a storage refuses is
    a `StorageError` that names the file.

    Args:
        base: path of the root in its file system or object store.

    Attributes:
        is_object_store: True if the root is in a bucket, which every process opens with its own credentials.
    """

    is_object_store: bool = False
    _kinds: ClassVar[dict[str, type[Store]]] = {}

    def __init__(self, base: str) -> None:
        self.base = base
        self._prefix = f"{base.rstrip('/')}/" if base else ""
        self._recorded: Mapping[str, str] | None = None
        self._last: tuple[str, bytes] = "", b""

    def __init_subclass__(cls, *, schemes: tuple[str, ...] = ()) -> None:
        """Register an implementation for addresses of these schemes; "" is a folder, "*" any other."""
        Store._kinds.update(dict.fromkeys(schemes, cls))

    @classmethod
    def open(cls, uri: str | Path) -> Store:
        """Return the store at a folder or a URI such as ``s3://bucket/folder`` or ``gs://bucket/folder``.

        Raises:
            ValueError: a URI that holds credentials, no bucket, or unknown parameters.
            ObjectStoreError: the region of a bucket cannot be found out, or the scheme is unknown.
        """
        check_type("root", uri, (str, Path), "a folder or an address")
        scheme, separator, _ = str(uri).partition("://")
        return Store._kinds.get(scheme if separator else "", Store._kinds["*"]).at(str(uri))

    @classmethod
    @abstractmethod
    def at(cls, uri: str) -> Store:
        """Return the store of this kind at a folder or address; raises as `open`."""

    def recorded(self, sha256: Mapping[str, str]) -> Self:
        """Return this store limited to files with recorded checksums, by path; nothing else is ever shown."""
        limited = copy.copy(self)
        limited._recorded = dict(sha256)
        return limited

    def where(self, path: str) -> str:
        """Return `path` with its root, as a message names it: no credentials of a URI."""
        return f"{self}/{path}" if path else str(self)

    def full_path(self, path: str) -> str:
        """Return `path` from the root of the file system or object store.

        Raises:
            ValueError: an absolute path, or one that leaves the root.
        """
        parts = [part for part in path.split("/") if part not in ("", ".")]  # a pure path takes 10 us
        if not parts or path.startswith("/") or ".." in parts or "\\" in path:
            raise ValueError(f"path {path!r} does not stay inside the root {self}; give a relative one")
        return self._prefix + "/".join(parts)

    def read_bytes(self, path: str, most_bytes: int | None = None) -> bytes:
        """Return the content of a file.

        Args:
            path: path of the file, from the root.
            most_bytes: size over which it is refused; by default that of JSON or of any other file.

        Raises:
            FileNotFoundError: there is none.
            DamagedFileError: something else lies there, it is too large, or it is not the recorded file.
        """
        data = self._read(path, most_bytes or (MOST_TEXT_BYTES if path.endswith(".json") else MOST_BYTES))
        if self._recorded is not None:
            if path not in self._recorded:
                raise DamagedFileError(f"{self.where(path)} is damaged: it is not of this release")
            if hashlib.sha256(data).hexdigest() != self._recorded[path]:
                raise DamagedFileError(f"{self.where(path)} is damaged: its sha256 is not the recorded one")
        return data

    def read_json(self, path: str, kind: type[T]) -> T:
        """Return the content of a JSON file as a `kind`; raises as `read_bytes` and `decode_json`."""
        return decode_json(self.read_bytes(path), kind, self.where(path))

    def write_json(self, path: str, record: DataclassInstance, indent: int | None = None) -> None:
        """Write a dataclass as JSON."""
        self.write_bytes(path, json.dumps(asdict(record), indent=indent).encode())

    def read_parts(self, path: str, read: Callable[[Any], T]) -> T:
        """Return the result of `read` for the opened file, of which it need not read all.

        For files that are never replaced. Raises as `read_bytes`.
        """
        if self._recorded is None:
            return self._read_parts(path, read)
        if self._last[0] != path:  # parts of a file are asked for one after the other
            self._last = path, self.read_bytes(path)
        return read(pa.BufferReader(self._last[1]))

    def names(self, folder: str = "") -> set[str]:
        """Return the names of files, folders and links directly in `folder`; none if it does not exist.

        Names that begin with a dot are never ours and left out, as is a file system's folder lost+found.
        """
        if self._recorded is None:
            return {name for name in self._names(folder) if not _NOT_OURS.search(name)}
        prefix = f"{folder}/" if folder else ""
        return {path[len(prefix) :].split("/")[0] for path in self._recorded if path.startswith(prefix)}

    def files(self, folder: str = "") -> tuple[str, ...]:
        """Return the paths of all files below `folder`, sorted; none if it does not exist; see also `names`.

        On a disk what lies in the place of a file is among them, so that whoever reads it names it: pipes,
        links that lead nowhere or out of the root, folders with the name of a file or that cannot be listed.
        """
        return tuple(self.stamps(folder))

    def stamps(self, folder: str = "") -> dict[str, Stamp]:
        """Return the `Stamp` of each of `files` below `folder`, by path, sorted."""
        return {path: stamp for path, stamp in self._stamps(folder).items() if not _NOT_OURS.search(path)}

    def temporary(self) -> str:
        """Return a new path for a temporary file, with a name that says that the file is ours."""
        return f"{TEMPORARY}/{self._mark()}{uuid4().hex}"

    def is_temporary(self, path: str) -> bool:
        """True if `path` is one that `temporary` may have returned for this root."""
        return re.fullmatch(f"{TEMPORARY}/{self._mark()}[0-9a-f]{{32}}", path) is not None

    def holds(self, path: str) -> bool:
        """True if anything lies at `path`: a file, or something else in its place."""
        return self.exists(path)

    def check_place(self, *folders: str) -> None:  # noqa: B027 - a bucket has nothing to check
        """Refuse a folder of this machine that cannot be a results root, and links that lead out of it.

        Raises:
            ResultsRootError: it is the root of the file system, the user's home, or a source checkout.
            DamagedFileError: a symbolic link in the path of one of `folders` leads out of the root.
        """

    def clear_temporaries(self, older_than: float) -> None:  # noqa: B027 - only a disk keeps any
        """Delete temporary files of killed processes on a disk that are older than `older_than` s."""

    def check_listable(self) -> None:  # noqa: B027 - a folder that is missing lists like an empty one
        """Refuse an object store whose bucket does not exist or cannot be listed: an ObjectStoreError."""

    def check_access(self) -> None:
        """Check the rights to list, write, read and delete outside of a disk; leaves nothing there.

        Raises:
            ObjectStoreError: a right or the bucket is missing.
            ResultsRootError: errors of `check_place`.
        """
        self.check_listable()
        probe = self.temporary()
        self.write_bytes(probe, b"may we write here?")
        self.read_bytes(probe)
        self.delete(probe)

    @abstractmethod
    def read_version(self, path: str) -> tuple[bytes, Version]:
        """Return the content of a small file, and its version for `replace`; raises as `read_bytes`."""

    @abstractmethod
    def write_bytes(self, path: str, data: bytes) -> None:
        """Write or replace a file, atomically and durably."""

    @abstractmethod
    def create(self, path: str, data: bytes) -> bool:
        """Write a new file; return False and change nothing if it exists.

        Exactly one of several writers makes it, in folders and in buckets.
        """

    @abstractmethod
    def replace(self, path: str, data: bytes, version: Version) -> bool:
        """Replace a file; return False and change nothing if its version is another.

        Exactly one of several writers that have read the same version replaces it: in a bucket by a
        conditional request, in a folder under a lock of its file system, where that has locks.
        """

    @abstractmethod
    def move(self, source: str, destination: str) -> None:
        """Move a file, replacing what is at `destination`; in an object store a copy, then a deletion.

        Raises:
            FileNotFoundError: there is nothing at `source`.
        """

    @abstractmethod
    def delete(self, path: str) -> None:
        """Delete a file, or a folder with its contents, if it exists."""

    @abstractmethod
    def exists(self, path: str) -> bool:
        """True if there is a file at `path`."""

    @abstractmethod
    def _stamps(self, folder: str = "") -> dict[str, Stamp]:
        """Return the `Stamp` of each file below `folder`, by path, sorted, whatever its name."""

    @abstractmethod
    def _read(self, path: str, most_bytes: int) -> bytes:
        """Return the content of a file of at most so many bytes; raises as `read_bytes`."""

    @abstractmethod
    def _read_parts(self, path: str, read: Callable[[Any], T]) -> T:
        """Return the result of `read` for the opened file; raise the errors of `read_bytes`."""

    @abstractmethod
    def _names(self, folder: str) -> set[str]:
        """Return the names of all that lies directly in `folder`; none if it does not exist."""

    def _mark(self) -> str:
        return "tma_ray-"


class _Ranges(io.RawIOBase):
    """A remote file, whose bytes from `start` on `fetch` returns."""

    def __init__(self, fetch: Callable[[int, int], bytes], size: int) -> None:
        self._fetch, self._size, self._at = fetch, size, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        self._at = offset + {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._size}[whence]
        return self._at

    def readinto(self, buffer: Any) -> int:
        count = max(0, min(len(buffer), self._size - self._at))
        if count:
            buffer[:count] = self._fetch(self._at, count)
            self._at += count
        return count


def opened_ranges(fetch: Callable[[int, int], bytes], size: int) -> pa.PythonFile:
    """Return a remote file of `size` bytes for pyarrow; `fetch` is given first byte and number of bytes."""
    ahead = 2**20  # bytes that are read at a time
    return pa.PythonFile(io.BufferedReader(_Ranges(fetch, size), ahead), mode="r")


def retry(action: Callable[[], T], seconds: float, give_up: Callable[[], bool] = lambda: False) -> T:
    """Repeat `action` as long as the storage refuses it; returns its first result.

    Args:
        action: operation that may be called again after a `StorageError`.
        seconds: time to repeat it, s.
        give_up: condition that ends the repetitions, asked before every pause.

    Raises:
        StorageError: it still refuses after `seconds`, or `give_up` returned true.
    """
    start, pause = time.monotonic(), FIRST_PAUSE
    while True:
        try:
            return action()
        except StorageError as error:
            passed = time.monotonic() - start
            if passed >= seconds or give_up():
                raise
            logger.warning("%s; trying again for another %.0f s", error, seconds - passed)
            time.sleep(min(pause, seconds - passed))
            pause = min(2 * pause, LONGEST_PAUSE)
