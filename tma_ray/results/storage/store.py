"""Files of a results root, on a disk or in an object store, each written whole or not at all."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from datetime import datetime
from pathlib import Path, PurePosixPath
from typing import Any, Final, Self, TypeVar, cast
from uuid import uuid4

from pyarrow import fs

from tma_ray.commands.arguments import check_kind
from tma_ray.commands.places import expanded
from tma_ray.decoding import (
    MOST_BYTES,
    MOST_TEXT_BYTES,
    DamagedFileError,
    check_file,
    check_size,
    read_file,
)
from tma_ray.results.storage import disk
from tma_ray.results.storage.addresses import open_address
from tma_ray.results.storage.errors import explained_disk
from tma_ray.results.storage.object_store import (
    ObjectStoreError,
    explained,
    open_bucket,
    patiently,
    read_object,
    unwritable,
)

T = TypeVar("T")

TEMPORARY: Final = "tmp"
"""Folder for temporary files: beside the tables, since their readers' patterns would match it there.

Others may keep files in it: ours have names that `Store.temporary` returns.
"""

_OBJECT_STORES: Final = ("s3", "gcs", "abfs")
_SCHEMES: Final = {"gcs": "gs"}


class Store:
    """Files under one root, addressed by relative paths with forward slashes.

    Others see a file whole or not at all: on a disk it is written aside, synced and renamed; an object store
    gets one PUT, or an upload whose end makes it visible. What a returned call has written survives a crash.
    Nothing is read, written, moved or deleted through a symbolic link that leads out of the root.

    A store can be pickled and sent to another process, which opens an object store anew with credentials of
    its own. What a disk refuses, or an object store goes on refusing, is a `StorageError` that names it.

    Args:
        filesystem: any `pyarrow.fs.FileSystem`.
        base: path of the root in it.
        uri: how another process opens it, if the file system itself should not travel.
    """

    def __init__(self, filesystem: Any, base: str, uri: str | None = None) -> None:
        self.filesystem = filesystem
        self._uri = uri
        self._local = isinstance(filesystem, fs.LocalFileSystem)
        self.base = base.rstrip("/") or ("/" if self._local else "")
        self._prefix = f"{self.base.rstrip('/')}/" if self.base else ""

    @classmethod
    def open(cls, uri: str | Path) -> Self:
        """Returns the store at a folder or a URI such as ``s3://bucket/folder`` or ``gs://bucket/folder``.

        Raises:
            ValueError: a URI that holds credentials, no bucket, or unknown parameters.
            ObjectStoreError: the region of a bucket cannot be found out.
        """
        check_kind("root", uri, (str, Path), "a folder or an address")
        if str(uri).startswith(("s3://", "gs://")):
            return cls(*open_bucket(str(uri)))
        if "://" in str(uri):
            return cls(*open_address(str(uri)))
        return cls(fs.LocalFileSystem(), expanded(uri).absolute().as_posix())

    def __str__(self) -> str:
        if self._local:
            return self.base
        name = self.filesystem.type_name.removeprefix("py::fsspec+")
        return self.base if "://" in self.base else f"{_SCHEMES.get(name, name)}://{self.base.lstrip('/')}"

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "filesystem": None} if self._uri else vars(self)

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        if self._uri:
            self.filesystem, _, _ = open_bucket(self._uri)

    @property
    def is_object_store(self) -> bool:
        """True if the root is in a bucket, which every process opens with credentials of its own."""
        return self.filesystem.type_name in _OBJECT_STORES

    def where(self, path: str) -> str:
        """Returns `path` with its root, as a message names it: no credentials of a URI."""
        return f"{self}/{path}"

    def read_bytes(self, path: str, most_bytes: int | None = None) -> bytes:
        """Returns the content of a file.

        Args:
            path: path of the file, from the root.
            most_bytes: size over which it is refused; by default that of JSON or of any other file.

        Raises:
            FileNotFoundError: there is none.
            DamagedFileError: something else lies there, or it is too large.
        """
        most = most_bytes or (MOST_TEXT_BYTES if path.endswith(".json") else MOST_BYTES)
        self._refuse_links_out(path)
        with self._explained(path):
            return patiently(lambda: self._read(path, most))

    def read_parts(self, path: str, read: Callable[[Any], T]) -> T:
        """Returns what `read` makes of the opened file, of which it need not read all.

        It may be called again. For files that are never replaced.

        Raises:
            FileNotFoundError: there is none.
            DamagedFileError: something else lies there, or it is too large.
        """

        def open_and_read() -> T:
            if self._local:
                check_file(self.full_path(path))
            with self.filesystem.open_input_file(self.full_path(path)) as file:
                return read(file)

        self._refuse_links_out(path)
        with self._explained(path):
            return patiently(open_and_read)

    def write_bytes(self, path: str, data: bytes) -> None:
        """Writes or replaces a file, atomically and durably."""
        target = self._own_path(path)
        with self._explained(path):
            if self._local:
                disk.write_file(Path(target), self._aside(), data)
                return
            self._make_parent(target)
            with self.filesystem.open_output_stream(target, compression=None) as stream:
                stream.write(data)  # one write: an object store publishes even an interrupted stream

    def create(self, path: str, data: bytes) -> bool:
        """Writes a new file as `write_bytes` does; returns False and changes nothing if there is one.

        On a disk exactly one of several processes makes it; elsewhere two may write at the same instant.
        """
        if not self._local:
            if self.exists(path):
                return False
            self.write_bytes(path, data)
            return True
        target = Path(self._own_path(path))
        with self._explained(path):
            return disk.write_file(target, self._aside(), data, exclusive=True)

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keeps other processes of this machine out of blocks under the same lock.

        The lock is the system's, on the root's folder, and ends with its process. Where there is none, as in
        object stores, or where it is not to be had for `LOCK_SECONDS`, the block is entered without.
        """
        if not self._local:
            yield
            return
        with disk.locked_folder(Path(self.base)):
            yield

    def exists(self, path: str) -> bool:
        """Tells whether there is a file at `path`."""
        return bool(self._info(path).type == fs.FileType.File)

    def holds(self, path: str) -> bool:
        """Returns True if anything lies at `path`, a file or something else in its place."""
        return os.path.lexists(self.full_path(path)) if self._local else self.exists(path)

    def size(self, path: str) -> int:
        """Returns how many bytes the file at `path` has, 0 where there is none."""
        return self._info(path).size or 0

    def modified_at(self, path: str) -> datetime | None:
        """Returns when the file at `path` was written, None where the storage does not say."""
        return cast("datetime | None", self._info(path).mtime)

    def entries(self, folder: str = "") -> tuple[str, ...]:
        """Returns the paths of files, folders and links in `folder`, sorted; none if it does not exist."""
        full = self.full_path(folder) if folder else self.base
        with self._explained(folder), suppress(FileNotFoundError, NotADirectoryError):
            if self._local:  # its file system leaves out links that lead nowhere
                found = [path.as_posix() for path in Path(full).iterdir()]
            else:
                found = [info.path for info in self.filesystem.get_file_info(fs.FileSelector(full))]
            return tuple(sorted(path.removeprefix(self._prefix) for path in found))
        return ()

    def files(self, folder: str = "") -> tuple[str, ...]:
        """Returns the paths of all files below `folder`, sorted; none if it does not exist.

        On a disk what lies in the place of a file is among them, so that whoever reads it names it: pipes,
        links that lead nowhere or out of the root, folders with the name of a file or that cannot be listed.
        """
        return tuple(self.stamps(folder))

    def stamps(self, folder: str = "") -> dict[str, tuple[int | None, int | None]]:
        """Returns time of writing (ns since 1970) and bytes of `files` below `folder`, by path, sorted.

        Both are None of what lies in the place of a file.
        """
        full = self.full_path(folder) if folder else self.base
        if self._local:
            self._refuse_links_out(folder)
            with self._explained(folder), suppress(FileNotFoundError):
                return dict(sorted(disk.stamps_below(self.base, full or "/")))
            return {}
        selector = fs.FileSelector(full, recursive=True, allow_not_found=True)
        with self._explained(folder):
            found = self.filesystem.get_file_info(selector)
        files = [info for info in found if info.type == fs.FileType.File]
        return dict(sorted((f.path.removeprefix(self._prefix), (f.mtime_ns, f.size)) for f in files))

    def names(self, folder: str) -> set[str]:
        """Returns the names of all that lies directly in `folder`; none if it does not exist."""
        full = self.full_path(folder)
        with self._explained(folder), suppress(FileNotFoundError):
            if self._local:
                return set(os.listdir(full))  # noqa: PTH208 - thousands of names
            found = self.filesystem.get_file_info(fs.FileSelector(full, allow_not_found=True))
            return {info.base_name for info in found}
        return set()

    def check_bucket(self) -> None:
        """Refuses an object store whose bucket does not exist, which reads and lists like an empty one.

        Raises:
            ObjectStoreError: the bucket does not exist, or we may not list it.
        """
        if self.is_object_store:
            with explained(str(self)), suppress(FileNotFoundError):  # that is an empty folder
                self.filesystem.get_file_info(fs.FileSelector(self.base))

    def check_place(self, *folders: str) -> None:
        """Refuses a folder of this machine that cannot be a results root, and links that lead out of it.

        Args:
            folders: paths of folders that are written to.

        Raises:
            ResultsRootError: it is the root of the file system, the user's home, or a source checkout.
            DamagedFileError: a symbolic link in the path of one of `folders` leads out of the root.
        """
        if self._local:
            with self._explained(""):
                disk.refuse_place(Path(self.base))
        for folder in folders:
            self._refuse_links_out(folder)

    def check_access(self) -> None:
        """Tries whether a place other than a disk lets us list, write, read and delete; leaves nothing there.

        Raises:
            ObjectStoreError: it does not, or the bucket does not exist.
            ResultsRootError: as `check_place`.
        """
        if self._local:
            self.check_place()
            return
        self.check_bucket()
        probe = self.temporary()
        try:
            self.write_bytes(probe, b"may we write here?")
            self.read_bytes(probe)
        except (FileNotFoundError, NotImplementedError) as error:
            raise ObjectStoreError(f"{self}: {unwritable(error)}") from error
        self.delete(probe)

    def move(self, source: str, destination: str) -> None:
        """Moves a file, replacing what is at `destination`; in an object store a copy, then a deletion.

        Raises:
            FileNotFoundError: there is nothing at `source`.
        """
        old, new = self._own_path(source), self._own_path(destination)
        with self._explained(source):
            self._make_parent(new)
            if self._local:
                Path(old).replace(new)
                disk.sync_folder(Path(new).parent)
                disk.sync_folder(Path(old).parent)
            else:
                self.filesystem.move(old, new)

    def delete(self, path: str) -> None:
        """Deletes a file, or a folder with all it holds; fine if there is none.

        On a disk a folder disappears at once, even while another process writes into it; of a symbolic link
        nothing but the link is deleted.
        """
        full = self._own_path(path)
        kind = self._info(path).type
        with self._explained(path):
            if self._local:
                here = Path(full)
                if kind == fs.FileType.Directory and not here.is_symlink():
                    here = here.replace(self._aside())  # what cannot be deleted is swept later
                disk.delete(here)
            elif kind == fs.FileType.File:
                self.filesystem.delete_file(full)
            elif kind == fs.FileType.Directory:
                self.filesystem.delete_dir(full)

    def clear_temporaries(self, older_than: float) -> None:
        """Deletes temporary files that killed processes left on a disk; other files in their folder stay.

        Args:
            older_than: age of what goes, s; younger files may be in the making.
        """
        if self._local:
            self._refuse_links_out(TEMPORARY)
            for path in filter(self.is_temporary, self.entries(TEMPORARY)):
                file = Path(self.full_path(path))
                with suppress(FileNotFoundError):  # finished meanwhile
                    if time.time() - file.lstat().st_mtime > older_than:
                        disk.delete(file)

    def temporary(self) -> str:
        """Returns a new path for a temporary file, whose folder is made on a disk.

        The name says that the file is ours, and on a disk which root made it, by the inode of its folder.

        Raises:
            DamagedFileError: the folder is a symbolic link that leads out of the root.
        """
        if self._local:
            self._refuse_links_out(TEMPORARY)
            disk.make_folder(Path(self.base, TEMPORARY))
        return f"{TEMPORARY}/{self._mark()}{uuid4().hex}"

    def is_temporary(self, path: str) -> bool:
        """True if `path` is one that `temporary` may have returned for this root."""
        return re.fullmatch(f"{TEMPORARY}/{self._mark()}[0-9a-f]{{32}}", path) is not None

    def full_path(self, path: str) -> str:
        """Returns `path` as the file system knows it.

        Raises:
            ValueError: an absolute path, or one that leaves the root.
        """
        parts = [part for part in path.split("/") if part not in ("", ".")]  # a pure path takes 10 us
        if not parts or path.startswith("/") or ".." in parts or "\\" in path:
            raise ValueError(f"path {path!r} does not stay inside the root {self}; give a relative one")
        return self._prefix + "/".join(parts)

    def _read(self, path: str, most_bytes: int) -> bytes:
        full = self.full_path(path)
        if self._local:
            return read_file(full, most_bytes)
        if self.is_object_store:
            return read_object(self.filesystem, full, self.where(path), most_bytes)
        with self.filesystem.open_input_file(full) as file:  # a stream would ask for it bit by bit
            check_size(self.where(path), file.size(), most_bytes)
            return cast("bytes", file.read())

    def _refuse_links_out(self, path: str) -> None:
        """Refuses symbolic links that lead out of the root: it may be others' who made it."""
        if self._local and disk.links_out(self.base, path):
            raise DamagedFileError(
                f"{self.where(path)} is damaged: a symbolic link leads out of the root or nowhere"
            )

    def _info(self, path: str) -> fs.FileInfo:
        with self._explained(path):
            return self.filesystem.get_file_info(self.full_path(path))

    def _explained(self, path: str) -> AbstractContextManager[None]:
        if self.is_object_store:
            return explained(self.where(path))
        return explained_disk(self.where(path)) if self._local else nullcontext()

    def _own_path(self, path: str) -> str:
        """Returns `path` as the file system knows it, unless a link in its folder leads out of the root."""
        full = self.full_path(path)
        self._refuse_links_out(str(PurePosixPath(path).parent))
        return full

    def _aside(self) -> Path:
        return Path(self.full_path(self.temporary()))

    def _mark(self) -> str:
        return f"tma_ray-{Path(self.base).stat().st_ino}-" if self._local else "tma_ray-"

    def _make_parent(self, full: str) -> None:
        folder = str(PurePosixPath(full).parent)
        if self._local:
            disk.make_folder(Path(folder))
        elif not self.is_object_store:  # they have no folders to make
            self.filesystem.create_dir(folder, recursive=True)
