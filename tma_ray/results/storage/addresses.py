"""Addresses that pyarrow or fsspec knows, such as ``https://…`` and ``hf://…``, as file systems.

What fsspec's file systems raise differs from one to the next, and several take every failure for a file that
is not there. Here a file is missing only if the place itself said so.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import PurePosixPath
from textwrap import shorten
from typing import Any, Final, TypeVar, cast

import pyarrow as pa
from pyarrow import fs

from tma_ray.results.storage.base import ObjectStoreError, Stamp, Store, Version, opened_ranges
from tma_ray.support.decoding import MOST_TEXT_BYTES, check_size

T = TypeVar("T")

EXPECTED: Final = (
    NotImplementedError,
    ImportError,
    ValueError,
    FileExistsError,
    IsADirectoryError,
    NotADirectoryError,
)
"""What file systems raise of a request that makes no sense to them: no matter of the connection."""


class AddressStore(Store, schemes=("*",)):
    """A folder at an address of a file system that pyarrow or fsspec knows, mostly to read releases.

    Such file systems have no conditional writes: `create` and `replace` look first, and exclude nobody.

    Args:
        filesystem: any file system of fsspec.
        base: path of the root in it.
    """

    def __init__(self, filesystem: Any, base: str) -> None:
        super().__init__(base.rstrip("/"))
        self.filesystem = filesystem
        protocol = filesystem.protocol
        self._scheme = protocol if isinstance(protocol, str) else protocol[0]
        self.is_object_store = self._scheme == "abfs"

    @classmethod
    def at(cls, uri: str) -> "AddressStore":
        try:
            from fsspec.core import url_to_fs
            from fsspec.implementations.arrow import ArrowFSWrapper

            with suppress(pa.ArrowInvalid, ValueError):  # not pyarrow's own: fsspec may know it
                filesystem, path = fs.FileSystem.from_uri(uri)
                handler = getattr(filesystem, "handler", None)
                if isinstance(handler, fs.FSSpecHandler):  # pyarrow hands some over to fsspec itself
                    return cls(handler.fs, path)
                return cls(ArrowFSWrapper(filesystem), path)
            return cls(*url_to_fs(uri))
        except (ImportError, ValueError) as error:
            where = uri.split("@")[-1]  # no password
            raise ObjectStoreError(
                f"{where}: {error}; pip install 'tma_ray[addresses]' has the libraries for https:// and hf://"
            ) from error

    def __str__(self) -> str:
        return self.base if "://" in self.base else f"{self._scheme}://{self.base.lstrip('/')}"

    def _read(self, path: str, most_bytes: int) -> bytes:
        with self._opened(path) as file, _reached(self.where(path)):
            check_size(self.where(path), _size(file), most_bytes)
            return cast("bytes", file.read())

    def _read_parts(self, path: str, read: Callable[[Any], T]) -> T:
        with self._opened(path) as file:

            def fetch(start: int, size: int) -> bytes:
                with _reached(self.where(path)):
                    file.seek(start)
                    return cast("bytes", file.read(size))

            return read(opened_ranges(fetch, _size(file)))

    def _opened(self, path: str) -> Any:
        if not self.exists(path):
            raise FileNotFoundError(self.where(path))
        with _reached(self.where(path)):
            return self.filesystem.open(self.full_path(path), "rb")

    def read_version(self, path: str) -> tuple[bytes, Version]:
        data = self._read(path, MOST_TEXT_BYTES)
        return data, data

    def write_bytes(self, path: str, data: bytes) -> None:
        """Write or replace a file.

        Raises:
            ObjectStoreError: addresses of this kind can only be read.
        """
        try:
            self._make_parent(path)
            with _reached(self.where(path)), self.filesystem.open(self.full_path(path), "wb") as stream:
                stream.write(data)  # one write: an object store publishes even an interrupted stream
        except NotImplementedError as error:
            raise ObjectStoreError(f"{self}: results at an address of this kind can only be read") from error

    def create(self, path: str, data: bytes) -> bool:
        if self.exists(path):
            return False
        self.write_bytes(path, data)
        return True

    def replace(self, path: str, data: bytes, version: Version) -> bool:
        if not self.exists(path) or self.read_version(path)[1] != version:
            return False
        self.write_bytes(path, data)
        return True

    def exists(self, path: str) -> bool:
        return self._kind(self.full_path(path), path) == "file"

    def _stamps(self, folder: str = "") -> dict[str, Stamp]:
        found = {
            path.removeprefix(self._prefix): (
                fs.FileInfo(path, mtime=info.get("mtime")).mtime_ns,
                info["size"],
            )
            for path, info in self._listed(folder).items()
            if info["type"] == "file"
        }
        return dict(sorted(found.items()))

    def _names(self, folder: str) -> set[str]:
        return {PurePosixPath(path).name for path in self._listed(folder, maxdepth=1)}

    def _listed(self, folder: str, maxdepth: int | None = None) -> dict[str, dict[str, Any]]:
        """Return what fsspec says of all below `folder`, by path."""
        full = self.full_path(folder) if folder else self.base
        with _reached(self.where(folder)):
            if not self.filesystem.isdir(full):
                if self._kind(full, folder):
                    raise NotADirectoryError(full)
                return {}
            found = self.filesystem.find(full, maxdepth=maxdepth, withdirs=True, detail=True)
        return {path: info for path, info in found.items() if path.strip("/") != full.strip("/")}

    def move(self, source: str, destination: str) -> None:
        self._make_parent(destination)
        with _reached(self.where(source)):
            self.filesystem.mv(self.full_path(source), self.full_path(destination), recursive=True)

    def delete(self, path: str) -> None:
        if self._kind(self.full_path(path), path):
            with _reached(self.where(path)):
                self.filesystem.rm(self.full_path(path), recursive=True)

    def _kind(self, full: str, path: str) -> str:
        """Return "file", "directory" or another word of fsspec's for what lies there; empty for nothing."""
        try:
            with _reached(self.where(path)):
                return str(self.filesystem.info(full)["type"])
        except FileNotFoundError:
            return ""

    def _make_parent(self, path: str) -> None:
        if not self.is_object_store:  # which has no folders to make
            with _reached(self.where(path)):
                self.filesystem.makedirs(str(PurePosixPath(self.full_path(path)).parent), exist_ok=True)


def _size(file: Any) -> int:
    """Return the size of an opened file, bytes."""
    # With pyarrow's file systems it is a method before fsspec 2025.12, which not all libraries allow yet.
    return cast("int", file.size() if callable(file.size) else file.size)


@contextmanager
def _reached(where: str) -> Iterator[None]:
    """Turn what libraries raise within the block of a connection into one error.

    Raises:
        FileNotFoundError: the place says that it lacks the file.
        ObjectStoreError: the place cannot be reached, or refuses.
    """
    try:
        yield
    except (ObjectStoreError, *EXPECTED):
        raise
    except Exception as error:  # of whichever library speaks to the place
        causes: list[BaseException] = [error]
        while causes[-1].__cause__ is not None:
            causes.append(causes[-1].__cause__)
        cause = next((each for each in causes if not _says_absent(each)), None)
        if cause is None:
            raise FileNotFoundError(f"{where} is not there") from error
        problem = "cannot be reached" if _status(cause) is None else "was refused"
        reason = shorten(str(cause), 200, placeholder=" …") or type(cause).__name__
        raise ObjectStoreError(
            f"{where} {problem}: {reason}; check the address, the network, and who may read there"
        ) from error


def _says_absent(error: BaseException) -> bool:
    status = _status(error)
    return isinstance(error, FileNotFoundError) if status is None else status in (404, 410)


def _status(error: BaseException) -> int | None:
    """Return the HTTP answer that an error of aiohttp or httpx reports, None if it is of another kind."""
    found = getattr(error, "status", None) or getattr(getattr(error, "response", None), "status_code", None)
    return found if isinstance(found, int) else None
