"""The files of runs compared with their manifests: checksums and row counts, each file read once."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Final

from tma_ray.decoding import DamagedFileError
from tma_ray.results.manifest import Manifest, PartFile
from tma_ray.results.merging.shared_files import UNREADABLE, damaged_rows, is_hit
from tma_ray.results.parquet import opened
from tma_ray.results.schema import SCHEMAS
from tma_ray.results.storage.errors import StorageError
from tma_ray.results.storage.store import Store

_THREADS: Final = 16  # more than cores: they wait for the object store


@dataclass(frozen=True)
class Damage:
    """One thing that is not as it was written.

    Attributes:
        path: of the file, from the results root.
        problem: what is the matter with it.
        run_id: of the run that it belongs to, empty if it holds several runs.
    """

    path: str
    problem: str
    run_id: str = ""

    def __str__(self) -> str:
        about = f"run {self.run_id}: " if self.run_id else ""
        return f"{about}{self.path}: {self.problem}"


@dataclass(frozen=True)
class Inspection:
    """Findings in the files of one run.

    Attributes:
        damage: what is not as it was written.
        newer: files with columns that this version does not know.
    """

    damage: tuple[Damage, ...] = ()
    newer: tuple[str, ...] = ()


class Inspector:
    """Compares the files of runs with their manifests, reading each file once.

    Damage of a file that many runs share is told of those runs only whose rows it hit.

    Args:
        store: the results root.
        raise_refusals: raises what a storage says that refuses to read, since it may read later; else that
            counts as damage, too.
    """

    def __init__(self, store: Store, *, raise_refusals: bool = True) -> None:
        self._store = store
        self._raise_refusals = raise_refusals
        self._shared: dict[str, tuple[Inspection, tuple[tuple[int, int], ...]]] = {}
        self._lock = threading.Lock()

    def inspect(self, manifest: Manifest) -> Inspection:
        """Returns what is wrong with the files that a manifest lists.

        Raises:
            StorageError: the storage refuses to read.
        """
        found = [self._inspect_file(manifest.run.run_id, file) for file in manifest.files]
        return Inspection(
            tuple(damage for each in found for damage in each.damage),
            tuple(path for each in found for path in each.newer),
        )

    def inspect_all(self, manifests: Sequence[Manifest]) -> Iterator[tuple[Manifest, Inspection]]:
        """Yields each manifest with what is wrong with its files."""
        # Small files of a disk are read faster by one thread.
        with ThreadPoolExecutor(_THREADS if self._store.is_object_store else 1) as executor:
            yield from zip(manifests, executor.map(self.inspect, manifests), strict=True)

    def _inspect_file(self, run_id: str, file: PartFile) -> Inspection:
        if file.first is None:
            return self._inspect_whole(file, run_id, file.rows)
        with self._lock:
            if file.path not in self._shared:
                found = self._inspect_whole(file, "", None)
                self._shared[file.path] = found, damaged_rows(self._store, file.path) if found.damage else ()
        found, hit = self._shared[file.path]
        if not found.damage:
            return found
        return Inspection(tuple(replace(each, run_id=run_id) for each in found.damage if is_hit(file, hit)))

    def _inspect_whole(self, file: PartFile, run_id: str, rows: int | None) -> Inspection:
        try:
            parquet = opened(file.read(self._store))
            count = parquet.metadata.num_rows
            if rows is not None and count != rows:
                raise DamagedFileError(f"it has {count:,} rows, but the manifest says {rows:,}")
        except UNREADABLE as error:
            self._raise_refusal(error)
            return Inspection(
                (Damage(file.path, damage_reason(error, self._store.where(file.path)), run_id),)
            )
        unknown = set(parquet.schema_arrow.names) - set(SCHEMAS[file.table].names)
        return Inspection(newer=(file.path,) if unknown else ())

    def _raise_refusal(self, error: Exception) -> None:
        if self._raise_refusals and isinstance(error, StorageError):
            raise error


def damage_reason(error: Exception, where: str) -> str:
    """Returns what is the matter with the file `where`, which raised `error` when it was read."""
    if isinstance(error, FileNotFoundError):
        return "it is missing"
    return str(error).removeprefix(f"{where} is damaged: ")
