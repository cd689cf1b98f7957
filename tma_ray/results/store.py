"""Files of a results root, on a disk or in an object store, each written whole or not at all."""

from __future__ import annotations

import os
import shutil
import time
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Any, Final, Self, cast
from uuid import uuid4

from pyarrow import fs

TEMPORARY: Final = "tmp"
"""Folder for files in the making: beside the tables, since their readers' patterns would match it there."""

_OBJECT_STORES: Final = ("s3", "gcs", "abfs")
_SCHEMES: Final = {"gcs": "gs"}


class Store:
    """Files under one root, addressed by relative paths with forward slashes.

    A file is seen by others complete or not at all: on a disk it is written aside, synced and
    renamed; in an object store it is one PUT of bytes built beforehand. What a returned call has
    written survives a crash of the machine. A store can be pickled and sent to another process.

    Args:
        filesystem: any `pyarrow.fs.FileSystem`.
        base: path of the root in it.
    """

    def __init__(self, filesystem: Any, base: str) -> None:
        self.filesystem = filesystem
        self.base = base.rstrip("/")
        self._local = isinstance(filesystem, fs.LocalFileSystem)
        self._prefix = f"{self.base}/" if self.base or self._local else ""

    @classmethod
    def open(cls, uri: str | Path) -> Self:
        """Returns the store at a folder or a URI such as ``s3://bucket/folder`` or ``gs://bucket/folder``."""
        if "://" in str(uri):
            return cls(*fs.FileSystem.from_uri(str(uri)))
        return cls(fs.LocalFileSystem(), Path(uri).expanduser().absolute().as_posix())

    def __str__(self) -> str:
        if self._local:
            return self.base
        scheme = self.filesystem.type_name
        return f"{_SCHEMES.get(scheme, scheme)}://{self.base}"

    def where(self, path: str) -> str:
        """Returns `path` with its root, as a message names it: no credentials of a URI."""
        return f"{self}/{path}"

    def read_bytes(self, path: str) -> bytes:
        """Returns the content of a file.

        Raises:
            FileNotFoundError: there is none.
        """
        with self.filesystem.open_input_stream(self.full_path(path), compression=None) as stream:
            return cast("bytes", stream.read())

    def write_bytes(self, path: str, data: bytes) -> None:
        """Writes or replaces a file, atomically and durably."""
        target = self.full_path(path)
        if self._local:
            self._write_local(Path(target), data)
            return
        self._make_parent(target)
        with self.filesystem.open_output_stream(target, compression=None) as stream:
            stream.write(data)  # one write: an object store publishes even an interrupted stream

    def exists(self, path: str) -> bool:
        """Tells whether there is a file at `path`."""
        return bool(self.filesystem.get_file_info(self.full_path(path)).type == fs.FileType.File)

    def files(self, folder: str = "") -> tuple[str, ...]:
        """Returns the paths of all files below `folder`, sorted; none if it does not exist."""
        full = self.full_path(folder) if folder else self.base
        selector = fs.FileSelector(full, recursive=True, allow_not_found=True)
        found = (info for info in self.filesystem.get_file_info(selector) if info.type == fs.FileType.File)
        return tuple(sorted(info.path.removeprefix(self._prefix) for info in found))

    def move(self, source: str, destination: str) -> None:
        """Moves a file, replacing what is at `destination`; in an object store a copy, then a deletion.

        Raises:
            FileNotFoundError: there is nothing at `source`.
        """
        old, new = self.full_path(source), self.full_path(destination)
        self._make_parent(new)
        if self._local:
            Path(old).replace(new)
            _sync_folder(Path(new).parent)
            _sync_folder(Path(old).parent)
        else:
            self.filesystem.move(old, new)

    def delete(self, path: str) -> None:
        """Deletes a file, or a folder with all it holds; fine if there is none.

        On a disk a folder disappears at once, even while another process writes into it.
        """
        full = self.full_path(path)
        kind = self.filesystem.get_file_info(full).type
        if kind == fs.FileType.File:
            self.filesystem.delete_file(full)
        elif kind == fs.FileType.Directory and self._local:
            aside = self._temporary()
            Path(full).replace(aside)
            shutil.rmtree(aside, ignore_errors=True)  # out of sight already; the rest is swept later
        elif kind == fs.FileType.Directory:
            self.filesystem.delete_dir(full)

    def clear_temporaries(self, older_than: float) -> None:
        """Deletes what killed processes left half made on a disk.

        Args:
            older_than: age of what goes, s; younger files may be in the making.
        """
        folder = Path(self.base, TEMPORARY)
        if not self._local or not folder.exists():
            return
        for entry in folder.iterdir():
            with suppress(FileNotFoundError):  # finished meanwhile
                if time.time() - entry.stat().st_mtime > older_than:
                    shutil.rmtree(entry) if entry.is_dir() else entry.unlink()

    def full_path(self, path: str) -> str:
        """Returns `path` as the file system knows it.

        Raises:
            ValueError: an absolute path, or one that leaves the root.
        """
        parts = PurePosixPath(path).parts
        if not parts or path.startswith("/") or ".." in parts or "\\" in path:
            raise ValueError(f"path {path!r} does not stay inside the root {self}; give a relative one")
        return self._prefix + "/".join(parts)

    def _write_local(self, target: Path, data: bytes) -> None:
        temporary = self._temporary()
        _make_folder(target.parent)
        try:
            with temporary.open("wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(target)
        finally:
            temporary.unlink(missing_ok=True)
        _sync_folder(target.parent)

    def _temporary(self) -> Path:
        folder = Path(self.base, TEMPORARY)
        _make_folder(folder)
        return folder / uuid4().hex

    def _make_parent(self, full: str) -> None:
        folder = PurePosixPath(full).parent
        if self._local:
            _make_folder(Path(folder))
        elif self.filesystem.type_name not in _OBJECT_STORES:  # they have no folders to make
            self.filesystem.create_dir(str(folder), recursive=True)


def _make_folder(folder: Path) -> None:
    """Makes a folder and its parents durably: each new name is synced in the folder that holds it."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    for path in reversed(missing):
        path.mkdir(exist_ok=True)
        _sync_folder(path.parent)


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
