"""Files that others published, each compared with the checksum that was published with them."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import pyarrow as pa

from tma_ray.decoding import DamagedFileError
from tma_ray.results.storage.store import Store

T = TypeVar("T")


class RecordedStore(Store):
    """A store that returns a file only if it is the recorded one: nothing else is ever shown.

    Files are read whole, since a checksum is that of a whole file.

    Args:
        store: where the files lie.
        sha256: of each file by its path, hexadecimal.
    """

    def __init__(self, store: Store, sha256: Mapping[str, str]) -> None:
        super().__init__(store.filesystem, store.base, store._uri)
        self._sha256 = dict(sha256)
        self._last: tuple[str, bytes] = "", b""

    def read_bytes(self, path: str, most_bytes: int | None = None) -> bytes:
        """Returns the content of a file.

        Args:
            path: path of the file, from the root.
            most_bytes: size over which it is refused, as `Store` has it.

        Raises:
            FileNotFoundError: there is none.
            DamagedFileError: it is not the recorded one, or none is recorded.
        """
        data = super().read_bytes(path, most_bytes)
        recorded = self._sha256.get(path)
        if recorded is None:
            raise DamagedFileError(f"{self.where(path)} is damaged: it is not of this release")
        if hashlib.sha256(data).hexdigest() != recorded:
            raise DamagedFileError(f"{self.where(path)} is damaged: its sha256 is not the recorded one")
        return data

    def names(self, folder: str) -> set[str]:
        """Returns the names of what is recorded directly in `folder`, without asking for it."""
        inner = (path.removeprefix(f"{folder}/") for path in self._sha256 if path.startswith(f"{folder}/"))
        return {path.split("/")[0] for path in inner}

    def read_parts(self, path: str, read: Callable[[Any], T]) -> T:
        """Returns what `read` makes of a file, compared as a whole first; raises as `read_bytes` does."""
        if self._last[0] != path:  # parts of a file are asked for one after the other
            self._last = path, self.read_bytes(path)
        return read(pa.BufferReader(self._last[1]))
