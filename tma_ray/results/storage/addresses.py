"""Addresses that pyarrow or fsspec knows, such as ``https://…`` and ``hf://…``, as file systems.

What fsspec's file systems raise differs from one to the next, and several take every failure for a file that
is not there. Here a file is missing only if the place itself said so.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import PurePosixPath
from textwrap import shorten
from typing import Any, Final, TypeVar, cast

import pyarrow as pa
from pyarrow import fs

from tma_ray.decoding import MOST_TEXT_BYTES, check_size
from tma_ray.results.storage.base import ObjectStoreError, Stamp, Store, Version

T = TypeVar("T")

ABSENT: Final = (404, 410)
"""HTTP answers of a place that lacks the file."""

REASON_LENGTH: Final = 200
"""Most characters of a library's own message that are shown."""

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
        filesystem: any `pyarrow.fs.FileSystem`.
        base: path of the root in it.
    """

    def __init__(self, filesystem: Any, base: str) -> None:
        super().__init__(base.rstrip("/"))
        self.filesystem = filesystem
        self.is_object_store = filesystem.type_name == "abfs"

    @classmethod
    def at(cls, uri: str) -> AddressStore:
        """Return the store at an address.

        Raises:
            ObjectStoreError: neither library knows its scheme, or one is missing.
        """
        return cls(*open_address(uri))

    def __str__(self) -> str:
        name = self.filesystem.type_name.removeprefix("py::fsspec+")
        return self.base if "://" in self.base else f"{name}://{self.base.lstrip('/')}"

    def _read(self, path: str, most_bytes: int) -> bytes:
        with self.filesystem.open_input_file(self.full_path(path)) as file:  # a stream would ask bit by bit
            check_size(self.where(path), file.size(), most_bytes)
            return cast("bytes", file.read())

    def _read_parts(self, path: str, read: Callable[[Any], T]) -> T:
        with self.filesystem.open_input_file(self.full_path(path)) as file:
            return read(file)

    def read_version(self, path: str) -> tuple[bytes, Version]:
        """Return the content of a small file, which is its version too."""
        data = self._read(path, MOST_TEXT_BYTES)
        return data, data

    def write_bytes(self, path: str, data: bytes) -> None:
        """Write or replaces a file.

        Raises:
            ObjectStoreError: addresses of this kind can only be read.
        """
        try:
            self._make_parent(path)
            with self.filesystem.open_output_stream(self.full_path(path), compression=None) as stream:
                stream.write(data)  # one write: an object store publishes even an interrupted stream
        except NotImplementedError as error:
            raise ObjectStoreError(f"{self}: results at an address of this kind can only be read") from error

    def create(self, path: str, data: bytes) -> bool:
        """Write a new file; False if there is one. Two may write at the same instant."""
        if self.exists(path):
            return False
        self.write_bytes(path, data)
        return True

    def replace(self, path: str, data: bytes, version: Version) -> bool:
        """Replace a file of this `version`; False if it is another. Two may write at the same instant."""
        if not self.exists(path) or self.read_version(path)[1] != version:
            return False
        self.write_bytes(path, data)
        return True

    def exists(self, path: str) -> bool:
        """True if there is a file at `path`."""
        return bool(self._info(path).type == fs.FileType.File)

    def stamps(self, folder: str = "") -> dict[str, Stamp]:
        """Return the `Stamp` of each of `files` below `folder`, by path, sorted."""
        found = self._listed(folder, recursive=True)
        files = [info for info in found if info.type == fs.FileType.File]
        return dict(sorted((f.path.removeprefix(self._prefix), (f.mtime_ns, f.size)) for f in files))

    def _names(self, folder: str) -> set[str]:
        return {info.base_name for info in self._listed(folder)}

    def _listed(self, folder: str, *, recursive: bool = False) -> list[fs.FileInfo]:
        full = self.full_path(folder) if folder else self.base
        selector = fs.FileSelector(full, recursive=recursive, allow_not_found=True)
        return cast("list[fs.FileInfo]", self.filesystem.get_file_info(selector))

    def move(self, source: str, destination: str) -> None:
        """Move a file, replacing what is at `destination`."""
        self._make_parent(destination)
        self.filesystem.move(self.full_path(source), self.full_path(destination))

    def delete(self, path: str) -> None:
        """Delete a file, or a folder with all it holds."""
        kind = self._info(path).type
        if kind == fs.FileType.File:
            self.filesystem.delete_file(self.full_path(path))
        elif kind == fs.FileType.Directory:
            self.filesystem.delete_dir(self.full_path(path))

    def _info(self, path: str) -> fs.FileInfo:
        return self.filesystem.get_file_info(self.full_path(path))

    def _make_parent(self, path: str) -> None:
        if not self.is_object_store:  # which has no folders to make
            parent = str(PurePosixPath(self.full_path(path)).parent)
            self.filesystem.create_dir(parent, recursive=True)


def open_address(uri: str) -> tuple[Any, str]:
    """Return the file system and path of an address that pyarrow or fsspec knows.

    Raises:
        ObjectStoreError: neither knows it, or a library is missing.
    """
    where = uri.split("@")[-1]  # no password
    try:
        filesystem, path = _opened(uri)
    except (ImportError, ValueError) as error:
        raise ObjectStoreError(
            f"{where}: {error}; pip install 'tma_ray[addresses]' has the libraries for https:// and hf://"
        ) from error
    if isinstance(filesystem, fs.FileSystem):
        return filesystem, path
    return fs.PyFileSystem(AddressHandler(filesystem)), path


def _opened(uri: str) -> tuple[Any, str]:
    """Return the file system of an address, pyarrow's or fsspec's, and the path in it."""
    with suppress(pa.ArrowInvalid, ValueError):  # not its own: fsspec may know it
        filesystem, path = fs.FileSystem.from_uri(uri)
        handler = getattr(filesystem, "handler", None)  # pyarrow hands some over to fsspec itself
        return (handler.fs if isinstance(handler, fs.FSSpecHandler) else filesystem), path
    from fsspec.core import url_to_fs

    return cast("tuple[Any, str]", url_to_fs(uri))


class AddressHandler(fs.FSSpecHandler):  # type: ignore[misc] # pyarrow has no types
    """A file system of fsspec, for pyarrow, that tells missing files from places that cannot be reached."""

    def get_file_info(self, paths: list[str]) -> list[fs.FileInfo]:
        """Return type and size of each path.

        Raises:
            ObjectStoreError: the place cannot be reached, or refuses.
        """
        return [self._info(path) for path in paths]

    def get_file_info_selector(self, selector: fs.FileSelector) -> list[fs.FileInfo]:
        """Return the entries of a folder; raise the errors of `get_file_info`."""
        with self._reached(selector.base_dir):
            found: list[fs.FileInfo] = super().get_file_info_selector(selector)
        if not found:
            self._info(selector.base_dir)
        return found

    def open_input_file(self, path: str) -> pa.PythonFile:
        """Return a file to read.

        Raises:
            FileNotFoundError: the place lacks it.
            ObjectStoreError: the place cannot be reached, or refuses.
        """
        if self._info(path).type != fs.FileType.File:
            raise FileNotFoundError(path)
        return self._opened(path, "r")

    def open_input_stream(self, path: str) -> pa.PythonFile:
        """Return a file to read; raises as `open_input_file`."""
        return self.open_input_file(path)

    def open_output_stream(self, path: str, metadata: Any) -> pa.PythonFile:  # noqa: ARG002 - as pyarrow asks
        """Return a file to write; raises as `get_file_info`."""
        return self._opened(path, "w")

    def create_dir(self, path: str, recursive: bool) -> None:
        """Make a folder; raises as `get_file_info`."""
        with self._reached(path):
            super().create_dir(path, recursive)

    def _opened(self, path: str, mode: str) -> pa.PythonFile:
        with self._reached(path):
            file = self.fs.open(path, mode=f"{mode}b")
        return pa.PythonFile(_ReachedFile(file, self.fs.unstrip_protocol(path)), mode=mode)

    def _reached(self, path: str) -> AbstractContextManager[None]:
        return _reached(self.fs.unstrip_protocol(path))

    def _info(self, path: str) -> fs.FileInfo:
        try:
            with self._reached(path):
                return self._create_file_info(path, self.fs.info(path))
        except FileNotFoundError:
            return fs.FileInfo(path, fs.FileType.NotFound)


class _ReachedFile:
    """A file of fsspec's whose failures are ours."""

    def __init__(self, file: Any, where: str) -> None:
        self._file = file
        self._where = where

    def read(self, size: int = -1) -> bytes:
        """Return the next `size` bytes, or all that are left."""
        with _reached(self._where):
            return cast("bytes", self._file.read(size))

    def write(self, data: bytes) -> int:
        """Write bytes, some of them when the file is closed."""
        with _reached(self._where):
            return cast("int", self._file.write(data))

    def close(self) -> None:
        """Write what is left."""
        with _reached(self._where):
            self._file.close()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


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
        cause = _refusal(error)
        if cause is None:
            raise FileNotFoundError(f"{where} is not there") from error
        problem = "cannot be reached" if _status(cause) is None else "was refused"
        reason = shorten(str(cause), REASON_LENGTH, placeholder=" …") or type(cause).__name__
        raise ObjectStoreError(
            f"{where} {problem}: {reason}; check the address, the network, and who may read there"
        ) from error


def _refusal(error: BaseException) -> BaseException | None:
    """Return the first of an error and its causes that is not of a missing file, None if all are."""
    causes = [error]
    while causes[-1].__cause__ is not None:
        causes.append(causes[-1].__cause__)
    return next((cause for cause in causes if not _says_absent(cause)), None)


def _says_absent(error: BaseException) -> bool:
    status = _status(error)
    return isinstance(error, FileNotFoundError) if status is None else status in ABSENT


def _status(error: BaseException) -> int | None:
    """Return the HTTP answer that an error of aiohttp or httpx reports, None if it is of another kind."""
    found = getattr(error, "status", None) or getattr(getattr(error, "response", None), "status_code", None)
    return found if isinstance(found, int) else None
