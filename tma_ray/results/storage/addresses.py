"""Addresses that pyarrow or fsspec knows, such as ``https://…`` and ``hf://…``, as file systems.

What fsspec's file systems raise differs from one to the next, and several take every failure for a file that
is not there. Here a file is missing only if the place itself said so.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from textwrap import shorten
from typing import Any, Final, cast

import pyarrow as pa
from pyarrow import fs

from tma_ray.results.storage.object_store import ObjectStoreError

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


def open_address(uri: str) -> tuple[Any, str]:
    """Returns the file system and path of an address that pyarrow or fsspec knows.

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
    """Returns the file system of an address, pyarrow's or fsspec's, and the path in it."""
    with suppress(pa.ArrowInvalid, ValueError):  # not its own: fsspec may know it
        filesystem, path = fs.FileSystem.from_uri(uri)
        handler = getattr(filesystem, "handler", None)  # pyarrow hands some over to fsspec itself
        return (handler.fs if isinstance(handler, fs.FSSpecHandler) else filesystem), path
    from fsspec.core import url_to_fs

    return cast("tuple[Any, str]", url_to_fs(uri))


class AddressHandler(fs.FSSpecHandler):  # type: ignore[misc] # pyarrow has no types
    """A file system of fsspec, for pyarrow, that tells missing files from places that cannot be reached."""

    def get_file_info(self, paths: list[str]) -> list[fs.FileInfo]:
        """Returns type and size of each path.

        Raises:
            ObjectStoreError: the place cannot be reached, or refuses.
        """
        return [self._info(path) for path in paths]

    def get_file_info_selector(self, selector: fs.FileSelector) -> list[fs.FileInfo]:
        """Returns what lies in a folder; raises as `get_file_info`."""
        with self._reached(selector.base_dir):
            found: list[fs.FileInfo] = super().get_file_info_selector(selector)
        if not found:
            self._info(selector.base_dir)
        return found

    def open_input_file(self, path: str) -> pa.PythonFile:
        """Returns a file to read.

        Raises:
            FileNotFoundError: the place lacks it.
            ObjectStoreError: the place cannot be reached, or refuses.
        """
        if self._info(path).type != fs.FileType.File:
            raise FileNotFoundError(path)
        return self._opened(path, "r")

    def open_input_stream(self, path: str) -> pa.PythonFile:
        """Returns a file to read; raises as `open_input_file`."""
        return self.open_input_file(path)

    def open_output_stream(self, path: str, metadata: Any) -> pa.PythonFile:  # noqa: ARG002 - as pyarrow asks
        """Returns a file to write; raises as `get_file_info`."""
        return self._opened(path, "w")

    def create_dir(self, path: str, recursive: bool) -> None:
        """Makes a folder; raises as `get_file_info`."""
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
        """Returns the next `size` bytes, or all that are left."""
        with _reached(self._where):
            return cast("bytes", self._file.read(size))

    def write(self, data: bytes) -> int:
        """Writes bytes, some of them when the file is closed."""
        with _reached(self._where):
            return cast("int", self._file.write(data))

    def close(self) -> None:
        """Writes what is left."""
        with _reached(self._where):
            self._file.close()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


@contextmanager
def _reached(where: str) -> Iterator[None]:
    """Turns what libraries raise within the block of a connection into one error.

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
    """Returns the first of an error and its causes that is not of a missing file, None if all are."""
    causes = [error]
    while causes[-1].__cause__ is not None:
        causes.append(causes[-1].__cause__)
    return next((cause for cause in causes if not _says_absent(cause)), None)


def _says_absent(error: BaseException) -> bool:
    status = _status(error)
    return isinstance(error, FileNotFoundError) if status is None else status in ABSENT


def _status(error: BaseException) -> int | None:
    """Returns the HTTP answer that an error of aiohttp or httpx reports, None if it is of another kind."""
    found = getattr(error, "status", None) or getattr(getattr(error, "response", None), "status_code", None)
    return found if isinstance(found, int) else None
