"""The files of runs compared with their manifests: checksums and row counts, each file read once."""

from __future__ import annotations

import threading
from collections.abc import Collection, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Final

from tma_ray.decoding import DamagedFileError
from tma_ray.results.layout import (
    CHECKPOINTS,
    LOGS,
    POLICIES,
    STAGING,
    TABLES,
    is_id,
    manifest_path,
)
from tma_ray.results.manifest import Manifest, PartFile
from tma_ray.results.merging.shared_files import UNREADABLE, damaged_rows, is_hit
from tma_ray.results.parquet import decode, opened
from tma_ray.results.records import RunStatus
from tma_ray.results.schema import DATA_TABLES, SCHEMAS, Table
from tma_ray.results.storage.errors import StorageError
from tma_ray.results.storage.store import Store

TRACES: Final = (*(f"{TABLES}/{table}" for table in DATA_TABLES), POLICIES, LOGS, CHECKPOINTS, STAGING)
"""Folders in which something is called like a run only after the run got its manifest."""

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
                self._shared[file.path] = found, damaged_rows(self._store, file) if found.damage else ()
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


def lost_manifests(
    store: Store, manifests: Collection[Manifest], damaged: Collection[str]
) -> dict[str, DamagedFileError]:
    """Returns the manifests that are gone, by path, with what shows that they were there.

    A run gets its manifest when it starts, and keeps it. One without has lost it if its row says that it
    is done, or if a row or cell lists it and one of the `TRACES` of runs that have started is there.

    Args:
        store: the results root.
        manifests: those that can be read.
        damaged: ids of the runs whose manifests cannot be read, but are there.
    """
    known = {manifest.run.run_id for manifest in manifests}.union(damaged)
    traces = {
        name.partition(".")[0]: f"{folder}/{name}" for folder in TRACES for name in _names(store, folder)
    }
    found = {}
    for path in _unknown_files(store, Table.RUNS, known):
        for row in _rows(store, Table.RUNS, path, ["run_id", "status"]):
            if row["run_id"] not in known and (row["status"] == RunStatus.DONE or row["run_id"] in traces):
                found[row["run_id"]] = traces.get(row["run_id"], path)
    merged = {file.path.rpartition("/")[2].partition(".")[0] for each in manifests for file in each.files}
    unclear = traces.keys() - known - merged - found.keys()
    for path in _unknown_files(store, Table.CELLS, ()) if unclear else ():
        ids = {row["run_id"] for row in _rows(store, Table.CELLS, path, ["run_id"])}
        found |= {run_id: traces[run_id] for run_id in unclear & ids}
    problem = "it is missing, although the run has been started: {} is there"
    return {
        manifest_path(run_id): DamagedFileError(problem.format(found[run_id]))
        for run_id in sorted(filter(is_id, found))
        if not store.holds(manifest_path(run_id))  # it may have started meanwhile
    }


def _unknown_files(store: Store, table: Table, run_ids: Collection[str]) -> Iterator[str]:
    """Yields the files of a table about runs that are not called like one of these runs."""
    folder = f"{TABLES}/{table}"
    names = sorted(_names(store, folder))
    yield from (f"{folder}/{name}" for name in names if name.removesuffix(".parquet") not in run_ids)


def _names(store: Store, folder: str) -> set[str]:
    with suppress(StorageError):  # a folder that cannot be listed shows nothing
        return store.names(folder)
    return set()


def _rows(store: Store, table: Table, path: str, columns: Sequence[str]) -> list[dict[str, str]]:
    with suppress(*UNREADABLE):  # whoever needs the file names it
        rows: list[dict[str, str]] = decode(table, store.read_bytes(path), columns).to_pylist()
        return rows
    return []


def damage_reason(error: Exception, where: str) -> str:
    """Returns what is the matter with the file `where`, which raised `error` when it was read."""
    if isinstance(error, FileNotFoundError):
        return "it is missing"
    return str(error).removeprefix(f"{where} is damaged: ")
