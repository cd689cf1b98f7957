"""Base class of storage backends, which read, write, list and delete files below a root."""

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

from tma_ray.support.decoding import MOST_FILE_BYTES, MOST_TEXT_BYTES, DamagedFileError, decode_json
from tma_ray.support.validation import check_type

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

ResultT = TypeVar("ResultT")

Version: TypeAlias = Any  # opaque version of a file's content

Stamp: TypeAlias = tuple[int | None, int | None]
"""Modification time (ns since 1970) and size (bytes) of a file, both None for anything else."""

TEMPORARY: Final = "tmp"  # folder of temporary files; see `Store.temporary`

_NOT_OURS: Final = re.compile(r"(^|/)\.|^lost\+found(/|$)")
"""Pattern of the names of foreign files, such as .DS_Store, ._name and .nfs files, and lost+found."""

FIRST_PAUSE: Final = 1.0  # pause after the first failure, s
LONGEST_PAUSE: Final = 60.0  # longest pause between two attempts, s

CONTINUES: Final = "what was published before is safe, and the same command continues from there"
"""End of messages about storage failures."""

logger = logging.getLogger(__name__)


class ResultsRootError(ValueError):
    """Error for an unusable results root; the message gives the reason and a remedy."""


class StorageError(OSError):
    """Error for a failed storage operation; the message gives the file and a remedy."""


class ObjectStoreError(StorageError, ConnectionError):
    """Error for a failed request to an object store; the message gives the file and a remedy."""


class Store(ABC):
    """Storage backend for files below a root, addressed by relative paths with forward slashes.

    Writes are atomic and durable. A store can be pickled; other processes open buckets with their own
    credentials. Failed operations raise a `StorageError`.

    Args:
        base: path of the root in its file system or object store.

    Attributes:
        is_object_store: True if the root is in a bucket.
    """

    is_object_store: bool = False
    _kinds: ClassVar[dict[str, type[Store]]] = {}

    def __init__(self, base: str) -> None:
        self.base = base
        self._prefix = f"{base.rstrip('/')}/" if base else ""
        self._recorded: Mapping[str, str] | None = None
        self._last: tuple[str, bytes] = "", b""

    def __init_subclass__(cls, *, schemes: tuple[str, ...] = ()) -> None:
        """Register an implementation for address `schemes`, where "" means folders and "*" all others."""
        Store._kinds.update(dict.fromkeys(schemes, cls))

    @classmethod
    def open(cls, uri: str | Path) -> Store:
        """Return the store at a folder or a URI such as ``s3://bucket/folder`` or ``gs://bucket/folder``.

        Raises:
            ValueError: if a URI has credentials, no bucket, or unknown parameters.
            ObjectStoreError: if the region of a bucket cannot be determined, or the scheme is unknown.
        """
        check_type("root", uri, (str, Path), "a folder or an address")
        scheme, separator, _ = str(uri).partition("://")
        return Store._kinds.get(scheme if separator else "", Store._kinds["*"]).at(str(uri))

    @classmethod
    @abstractmethod
    def at(cls, uri: str) -> Store:
        """Return the store of this kind at a folder or address."""

    def recorded(self, sha256: Mapping[str, str]) -> Self:
        """Return a copy of this store that only reads the files in `sha256`, and verifies these checksums."""
        limited = copy.copy(self)
        limited._recorded = dict(sha256)
        return limited

    def where(self, path: str) -> str:
        """Return `path` with its root, without credentials, for use in messages."""
        return f"{self}/{path}" if path else str(self)

    def full_path(self, path: str) -> str:
        """Return the full path or key of `path`, or raise a ValueError if it lies outside of the root."""
        parts = [part for part in path.split("/") if part not in ("", ".")]  # a PurePath would take 10 us
        if not parts or path.startswith("/") or ".." in parts or "\\" in path:
            raise ValueError(f"path {path!r} does not stay inside the root {self}; give a relative one")
        return self._prefix + "/".join(parts)

    def read_bytes(self, path: str, most_bytes: int | None = None) -> bytes:
        """Return the content of a file.

        Args:
            path: path of the file, from the root.
            most_bytes: size limit; by default `MOST_TEXT_BYTES` for JSON, else `MOST_FILE_BYTES`.

        Raises:
            FileNotFoundError: if the file is missing.
            DamagedFileError: if it is not a file, too large, or differs from the recorded checksum.
        """
        data = self._read(
            path, most_bytes or (MOST_TEXT_BYTES if path.endswith(".json") else MOST_FILE_BYTES)
        )
        if self._recorded is not None:
            if path not in self._recorded:
                raise DamagedFileError(f"{self.where(path)} is damaged: it is not of this release")
            if hashlib.sha256(data).hexdigest() != self._recorded[path]:
                raise DamagedFileError(f"{self.where(path)} is damaged: its sha256 is not the recorded one")
        return data

    def read_json(self, path: str, kind: type[ResultT]) -> ResultT:
        """Return the content of a JSON file, decoded as `kind`."""
        return decode_json(self.read_bytes(path), kind, self.where(path))

    def write_json(self, path: str, record: DataclassInstance, indent: int | None = None) -> None:
        """Write a dataclass to a JSON file."""
        self.write_bytes(path, json.dumps(asdict(record), indent=indent).encode())

    def read_parts(self, path: str, read: Callable[[Any], ResultT]) -> ResultT:
        """Open a file that is never replaced, and return the result of calling `read` with it."""
        if self._recorded is None:
            return self._read_parts(path, read)
        if self._last[0] != path:  # cached, since several parts of a file may be read
            self._last = path, self.read_bytes(path)
        return read(pa.BufferReader(self._last[1]))

    def names(self, folder: str = "") -> set[str]:
        """Return the names in `folder` (none if it does not exist), except hidden files and lost+found."""
        if self._recorded is None:
            return {name for name in self._names(folder) if not _NOT_OURS.search(name)}
        prefix = f"{folder}/" if folder else ""
        return {path[len(prefix) :].split("/")[0] for path in self._recorded if path.startswith(prefix)}

    def files(self, folder: str = "") -> tuple[str, ...]:
        """Return the sorted paths of all files below `folder`, except hidden files and lost+found.

        On a disk they include entries that readers should report: pipes, broken links and links out of the
        root, folders named like files, and unreadable folders.
        """
        return tuple(self.stamps(folder))

    def stamps(self, folder: str = "") -> dict[str, Stamp]:
        """Return the stamps of all files below `folder`, sorted by path; see `files`."""
        return {path: stamp for path, stamp in self._stamps(folder).items() if not _NOT_OURS.search(path)}

    def temporary(self) -> str:
        """Return a new path for a temporary file, marked as belonging to this root."""
        return f"{TEMPORARY}/{self._mark()}{uuid4().hex}"

    def is_temporary(self, path: str) -> bool:
        """Return True if `path` may have come from `temporary`."""
        return re.fullmatch(f"{TEMPORARY}/{self._mark()}[0-9a-f]{{32}}", path) is not None

    def holds(self, path: str) -> bool:
        """Return True if anything exists at `path`, whether a file or not."""
        return self.exists(path)

    def check_location(self, *folders: str) -> None:  # noqa: B027 - a bucket has nothing to check
        """Check that a local folder can be a results root, and that no link leads out of it.

        Raises:
            ResultsRootError: if it is the root of the file system, the user's home, or a source checkout.
            DamagedFileError: if a symbolic link in one of `folders` leads out of the root.
        """

    def clear_temporaries(self, older_than: float) -> None:  # noqa: B027 - only a disk keeps any
        """Delete temporary files that are older than `older_than` seconds."""

    def check_listable(self) -> None:  # noqa: B027 - missing folders are empty
        """Raise an ObjectStoreError if a bucket does not exist or cannot be listed."""

    def check_access(self) -> None:
        """Check the permissions to list, write, read and delete, or raise an ObjectStoreError."""
        self.check_listable()
        probe = self.temporary()
        self.write_bytes(probe, b"may we write here?")
        self.read_bytes(probe)
        self.delete(probe)

    @abstractmethod
    def read_version(self, path: str) -> tuple[bytes, Version]:
        """Return the content and the version of a small file."""

    @abstractmethod
    def write_bytes(self, path: str, data: bytes) -> None:
        """Write or replace a file."""

    @abstractmethod
    def create(self, path: str, data: bytes) -> bool:
        """Write a new file, or return False if it exists; exactly one of several writers succeeds."""

    @abstractmethod
    def replace(self, path: str, data: bytes, version: Version) -> bool:
        """Replace a file, or return False if its version has changed.

        Exactly one of several writers succeeds, except on file systems without locks.
        """

    @abstractmethod
    def move(self, source: str, destination: str) -> None:
        """Move a file, replacing `destination`; this is not atomic in object stores."""

    @abstractmethod
    def delete(self, path: str) -> None:
        """Delete a file, or a folder with its contents, if it exists."""

    @abstractmethod
    def exists(self, path: str) -> bool:
        """Return True if there is a file at `path`."""

    @abstractmethod
    def _stamps(self, folder: str = "") -> dict[str, Stamp]:
        """Return the stamps of all files below `folder`, including hidden ones, sorted by path."""

    @abstractmethod
    def _read(self, path: str, most_bytes: int) -> bytes:
        """Return the content of a file that must have at most `most_bytes`."""

    @abstractmethod
    def _read_parts(self, path: str, read: Callable[[Any], ResultT]) -> ResultT:
        """Call `read` with the open file and return the result."""

    @abstractmethod
    def _names(self, folder: str) -> set[str]:
        """Return all names in `folder`; empty if it does not exist."""

    def _mark(self) -> str:
        return "tma_ray-"


class _Ranges(io.RawIOBase):
    """Remote file that is read by `fetch(start, size)`."""

    def __init__(self, fetch: Callable[[int, int], bytes], size: int) -> None:
        self._fetch, self._size, self._offset = fetch, size, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        self._offset = offset + {io.SEEK_SET: 0, io.SEEK_CUR: self._offset, io.SEEK_END: self._size}[whence]
        return self._offset

    def readinto(self, buffer: Any) -> int:
        count = max(0, min(len(buffer), self._size - self._offset))
        if count:
            buffer[:count] = self._fetch(self._offset, count)
            self._offset += count
        return count


def opened_ranges(fetch: Callable[[int, int], bytes], size: int) -> pa.PythonFile:
    """Open a remote file of `size` bytes for pyarrow, to be read by `fetch(start, size)`."""
    ahead = 2**20  # bytes to read ahead
    return pa.PythonFile(io.BufferedReader(_Ranges(fetch, size), ahead), mode="r")


def growing_pause(failures: int, longest: float) -> float:
    """Return the pause, in seconds, after a number of failures: exponential backoff up to `longest`."""
    return min(FIRST_PAUSE * 2.0 ** min(failures - 1, 60), longest)


def retry(
    action: Callable[[], ResultT], seconds: float, give_up: Callable[[], bool] = lambda: False
) -> ResultT:
    """Call `action`, with retries after StorageErrors for a limited time, and return its result.

    Args:
        action: repeatable operation.
        seconds: time limit of the repetitions, s.
        give_up: condition that ends the repetitions, checked before every pause.

    Raises:
        StorageError: if it still fails after `seconds`, or `give_up` returned True.
    """
    start, failures = time.monotonic(), 0
    while True:
        try:
            return action()
        except StorageError as error:
            passed = time.monotonic() - start
            if passed >= seconds or give_up():
                raise
            failures += 1
            logger.warning("%s; trying again for another %.0f s", error, seconds - passed)
            time.sleep(min(growing_pause(failures, LONGEST_PAUSE), seconds - passed))
