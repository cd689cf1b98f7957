"""Storage at addresses that pyarrow or fsspec supports, such as ``https://…`` and ``hf://…``.

File systems of fsspec raise different errors, and several report any failure as a missing file. Here a file
is missing only if the server reports it.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import PurePosixPath
from textwrap import shorten
from typing import Any, Final, cast

import pyarrow as pa
from pyarrow import fs

from tma_ray.results.storage.base import ObjectStoreError, ResultT, Stamp, Store, Version, opened_ranges
from tma_ray.support.decoding import MOST_TEXT_BYTES, check_size

_USAGE_ERRORS: Final = (
    NotImplementedError,
    ImportError,
    ValueError,
    FileExistsError,
    IsADirectoryError,
    NotADirectoryError,
)
"""Errors of invalid requests, which are unrelated to the connection."""


class AddressStore(Store, schemes=("*",)):
    """Store at an address that pyarrow or fsspec supports, used mostly to read releases.

    Writes are not conditional: `create` and `replace` check first, and do not exclude other processes.

    Args:
        filesystem: file system of fsspec.
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

            with suppress(pa.ArrowInvalid, ValueError):  # if not supported by pyarrow, fsspec may support it
                filesystem, path = fs.FileSystem.from_uri(uri)
                handler = getattr(filesystem, "handler", None)
                if isinstance(handler, fs.FSSpecHandler):  # pyarrow delegates some schemes to fsspec
                    return cls(handler.fs, path)
                return cls(ArrowFSWrapper(filesystem), path)
            return cls(*url_to_fs(uri))
        except (ImportError, ValueError) as error:
            address = uri.split("@")[-1]  # strip a password
            raise ObjectStoreError(
                f"{address}: {error}; pip install 'tma_ray[addresses]' has the libraries for https:// and hf://"
            ) from error

    def __str__(self) -> str:
        return self.base if "://" in self.base else f"{self._scheme}://{self.base.lstrip('/')}"

    def _read(self, path: str, most_bytes: int) -> bytes:
        with self._opened(path) as file, _reached(self.where(path)):
            check_size(self.where(path), _size(file), most_bytes)
            return cast("bytes", file.read())

    def _read_parts(self, path: str, read: Callable[[Any], ResultT]) -> ResultT:
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
        """Write or replace a file, or raise an ObjectStoreError if the address is read-only."""
        try:
            self._make_parent(path)
            with _reached(self.where(path)), self.filesystem.open(self.full_path(path), "wb") as stream:
                stream.write(data)  # in one write, since object stores publish even interrupted streams
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
        stamps = {
            path.removeprefix(self._prefix): (
                fs.FileInfo(path, mtime=info.get("mtime")).mtime_ns,
                info["size"],
            )
            for path, info in self._listed(folder).items()
            if info["type"] == "file"
        }
        return dict(sorted(stamps.items()))

    def _names(self, folder: str) -> set[str]:
        return {PurePosixPath(path).name for path in self._listed(folder, maxdepth=1)}

    def _listed(self, folder: str, maxdepth: int | None = None) -> dict[str, dict[str, Any]]:
        """Return fsspec's information about all files and folders below `folder`, by path."""
        full = self.full_path(folder) if folder else self.base
        with _reached(self.where(folder)):
            if not self.filesystem.isdir(full):
                if self._kind(full, folder):
                    raise NotADirectoryError(full)
                return {}
            entries = self.filesystem.find(full, maxdepth=maxdepth, withdirs=True, detail=True)
        return {path: info for path, info in entries.items() if path.strip("/") != full.strip("/")}

    def move(self, source: str, destination: str) -> None:
        self._make_parent(destination)
        with _reached(self.where(source)):
            self.filesystem.mv(self.full_path(source), self.full_path(destination), recursive=True)

    def delete(self, path: str) -> None:
        if self._kind(self.full_path(path), path):
            with _reached(self.where(path)):
                self.filesystem.rm(self.full_path(path), recursive=True)

    def _kind(self, full: str, path: str) -> str:
        """Return fsspec's type of an entry ("file", "directory", ...), or "" if there is no entry."""
        try:
            with _reached(self.where(path)):
                return str(self.filesystem.info(full)["type"])
        except FileNotFoundError:
            return ""

    def _make_parent(self, path: str) -> None:
        if not self.is_object_store:  # object stores have no folders
            with _reached(self.where(path)):
                self.filesystem.makedirs(str(PurePosixPath(self.full_path(path)).parent), exist_ok=True)


def _size(file: Any) -> int:
    """Return the size of an open file in bytes."""
    # before fsspec 2025.12, `size` is a method for pyarrow's file systems
    return cast("int", file.size() if callable(file.size) else file.size)


@contextmanager
def _reached(where: str) -> Iterator[None]:
    """Context manager that converts errors of libraries to FileNotFoundError or ObjectStoreError.

    Raises:
        FileNotFoundError: if the server reports a missing file.
        ObjectStoreError: if the server is unreachable, or refuses the request.
    """
    try:
        yield
    except (ObjectStoreError, *_USAGE_ERRORS):
        raise
    except Exception as error:  # libraries raise errors of any type
        causes: list[BaseException] = [error]
        while causes[-1].__cause__ is not None:
            causes.append(causes[-1].__cause__)
        cause = next((reason for reason in causes if not _is_missing(reason)), None)
        if cause is None:
            raise FileNotFoundError(f"{where} is not there") from error
        problem = "cannot be reached" if _status(cause) is None else "was refused"
        reason = shorten(str(cause), 200, placeholder=" …") or type(cause).__name__
        raise ObjectStoreError(
            f"{where} {problem}: {reason}; check the address, the network, and who may read there"
        ) from error


def _is_missing(error: BaseException) -> bool:
    status = _status(error)
    return isinstance(error, FileNotFoundError) if status is None else status in (404, 410)


def _status(error: BaseException) -> int | None:
    """Return the HTTP status of an error of aiohttp or httpx, or None for other errors."""
    status = getattr(error, "status", None) or getattr(getattr(error, "response", None), "status_code", None)
    return status if isinstance(status, int) else None
