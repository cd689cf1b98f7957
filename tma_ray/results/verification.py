"""Verification of a results root against its manifests."""

import threading
from collections.abc import Collection, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any, Final

import pyarrow as pa
import pyarrow.compute as pc

import tma_ray.results.layout as layout  # noqa: PLR0402 - this module is imported by the package
from tma_ray.results.inputs import damaged_inputs
from tma_ray.results.manifest import (
    UNREADABLE,
    Manifest,
    PartFile,
    damaged_rows,
    load_manifest,
    overlaps,
    read_index,
)
from tma_ray.results.parquet import decode, opened
from tma_ray.results.records import RunStatus
from tma_ray.results.schema import DATA_TABLES, SCHEMAS, Table
from tma_ray.results.storage import StorageError, Store
from tma_ray.support.decoding import DamagedFileError, decode_json

TRACES: Final = (
    *(f"{layout.TABLES}/{table}" for table in DATA_TABLES),
    layout.POLICIES,
    layout.LOGS,
    layout.CHECKPOINTS,
    layout.STAGING,
)
"""Folders of files that are named after runs and show that a run had a manifest."""

_THREADS: Final = 16  # may exceed the number of cores, since threads mostly wait for the object store


@dataclass(frozen=True)
class Damage:
    """Damage to one file of a results root.

    Attributes:
        path: path of the file, relative to the results root.
        problem: description of the damage.
        run_id: id of the run, empty for a file of several runs.
    """

    path: str
    problem: str
    run_id: str = ""

    def __str__(self) -> str:
        about = f"run {self.run_id}: " if self.run_id else ""
        return f"{about}{self.path}: {self.problem}"


@dataclass(frozen=True)
class Inspection:
    """Damage to the files of one run, and the files with columns unknown to this version."""

    damage: tuple[Damage, ...] = ()
    newer: tuple[str, ...] = ()


class Inspector:
    """Inspector that compares runs' files with the manifests, reading each file once.

    Damage to a shared file is reported for the runs whose rows are affected.

    Args:
        store: store of the results root.
        raise_refusals: True to raise a StorageError, which may be temporary, False to report it as damage.
    """

    def __init__(self, store: Store, *, raise_refusals: bool = True) -> None:
        self._store = store
        self._raise_refusals = raise_refusals
        self._shared: dict[str, tuple[str, bool, tuple[tuple[int, int], ...]]] = {}
        self._lock = threading.Lock()

    def inspect_all(self, manifests: Sequence[Manifest]) -> Iterator[tuple[Manifest, Inspection]]:
        """Yield each manifest with the inspection of its files."""
        # a single thread reads small files from a disk faster than several
        with ThreadPoolExecutor(_THREADS if self._store.is_object_store else 1) as executor:
            yield from zip(manifests, executor.map(self._inspect, manifests), strict=True)

    def _inspect(self, manifest: Manifest) -> Inspection:
        damage, newer = [], []
        for file in manifest.files:
            if file.first is None:
                problem, has_more = self._inspect_file(file)
                hit = True
            else:
                with self._lock:
                    if file.path not in self._shared:
                        problem, has_more = self._inspect_file(file)
                        rows = damaged_rows(self._store, file) if problem else ()
                        self._shared[file.path] = problem, has_more, rows
                problem, has_more, rows = self._shared[file.path]
                hit = overlaps(file, rows)
            if problem and hit:
                damage.append(Damage(file.path, problem, manifest.run.run_id))
            if has_more:
                newer.append(file.path)
        return Inspection(tuple(damage), tuple(newer))

    def _inspect_file(self, file: PartFile) -> tuple[str, bool]:
        """Return a file's damage (empty if intact), and True if the file has unknown columns."""
        try:
            parquet = opened(file.read(self._store))
            count = parquet.metadata.num_rows
            if file.first is None and count != file.rows:
                raise DamagedFileError(f"it has {count:,} rows, but the manifest says {file.rows:,}")
        except UNREADABLE as error:
            if self._raise_refusals and isinstance(error, StorageError):
                raise
            return damage_reason(error, self._store.where(file.path)), False
        return "", not set(parquet.schema_arrow.names) <= set(SCHEMAS[file.table].names)


def lost_manifests(
    store: Store, manifests: Collection[Manifest], damaged: Collection[str]
) -> dict[str, DamagedFileError]:
    """Return errors for lost manifests, by path.

    A manifest counts as lost if the run's row has the status done, or if a row or cell lists the run and
    files in `TRACES` are named after it.

    Args:
        store: store of the results root.
        manifests: readable manifests.
        damaged: ids of runs with unreadable manifests.
    """
    listed = {manifest.run.run_id for manifest in manifests}.union(damaged)
    traces = {
        name.partition(".")[0]: f"{folder}/{name}" for folder in TRACES for name in _names(store, folder)
    }
    lost = {}
    for path in _unknown_files(store, Table.RUNS, listed):
        for row in _rows(store, Table.RUNS, path, ["run_id", "status"]):
            if row["run_id"] not in listed and (row["status"] == RunStatus.DONE or row["run_id"] in traces):
                lost[row["run_id"]] = traces.get(row["run_id"], path)
    merged = {PurePosixPath(file.path).name.partition(".")[0] for run in manifests for file in run.files}
    unclear = traces.keys() - listed - merged - lost.keys()
    for path in _unknown_files(store, Table.CELLS, ()) if unclear else ():
        ids = {row["run_id"] for row in _rows(store, Table.CELLS, path, ["run_id"])}
        lost |= {run_id: traces[run_id] for run_id in unclear & ids}
    problem = "it is missing, although the run has been started: {} is there"
    return {
        layout.manifest_path(run_id): DamagedFileError(problem.format(lost[run_id]))
        for run_id in sorted(filter(layout.is_id, lost))
        if not store.holds(layout.manifest_path(run_id))  # the run may have started since
    }


def _unknown_files(store: Store, table: Table, run_ids: Collection[str]) -> Iterator[str]:
    """Yield the files of a table about runs, except files named after one of `run_ids`."""
    folder = f"{layout.TABLES}/{table}"
    names = sorted(_names(store, folder))
    yield from (f"{folder}/{name}" for name in names if name.removesuffix(".parquet") not in run_ids)


def _names(store: Store, folder: str) -> set[str]:
    with suppress(StorageError):  # ignore unreadable folders
        return store.names(folder)
    return set()


def _rows(store: Store, table: Table, path: str, columns: Sequence[str]) -> list[dict[str, str]]:
    with suppress(*UNREADABLE):  # a damaged file is reported when results are read
        rows: list[dict[str, str]] = decode(table, store.read_bytes(path), columns).to_pylist()
        return rows
    return []


def damage_reason(error: Exception, where: str) -> str:
    """Describe the damage to the file `where`, given the error raised on reading it."""
    if isinstance(error, FileNotFoundError):
        return "it is missing"
    return str(error).removeprefix(f"{where} is damaged: ")


SPEC_FILE: Final = "spec.json"  # file with the run's spec, beside every saved policy


@dataclass(frozen=True)
class RootVerification:
    """Result of the verification of a results root.

    Attributes:
        runs: number of runs with a readable manifest.
        files: path and sha256 of each file in their manifests.
        damage: damage of the root.
        unlisted: files of tables and policies that belong to no run; readers ignore them.
    """

    runs: int
    files: tuple[tuple[str, str], ...]
    damage: tuple[Damage, ...] = ()
    unlisted: tuple[str, ...] = ()


def verify_root(store: Store) -> RootVerification:
    """Compare all files of a results root with the manifests.

    Raises:
        ResultsRootError: if the root does not exist, or is of another version.
    """
    layout.check_root(store)
    damage: list[Damage] = []

    def report(path: str, error: Exception) -> None:
        damage.append(Damage(path, damage_reason(error, store.where(path))))

    manifests, paths = [], store.files(layout.MANIFESTS)
    for path in paths:
        try:
            manifests.append(load_manifest(store, path))
        except UNREADABLE as error:
            report(path, error)
    ids = {PurePosixPath(path).stem for path in paths}
    for name, entry in read_index(store):
        if isinstance(entry, Exception):
            report(name, entry)
        elif entry.run.run_id not in ids:
            manifests.append(entry)
    lost = lost_manifests(store, manifests, {PurePosixPath(item.path).stem for item in damage})
    damage += [Damage(path, str(error), PurePosixPath(path).stem) for path, error in lost.items()]
    for _, inspection in Inspector(store, raise_refusals=False).inspect_all(manifests):
        damage += inspection.damage
    damage += _listed_twice(manifests)
    damage += _foreign_rows(store, manifests)
    damage += _tables_about_runs(store)
    damage += _foreign_policies(store, manifests)
    damage += (Damage(*entry) for entry in damaged_inputs(store, [manifest.run for manifest in manifests]))
    listed = {(file.path, file.sha256) for manifest in manifests for file in manifest.files}
    readable = {manifest.run.run_id for manifest in manifests}
    rows = [path for table in DATA_TABLES for path in store.files(f"{layout.TABLES}/{table}")]
    unlisted = [path for path in rows if path not in {path for path, _ in listed}]
    unlisted += [
        path for path in store.files(layout.POLICIES) if PurePosixPath(path).parts[1] not in readable
    ]
    files = tuple(sorted(listed))
    return RootVerification(len(manifests), files, tuple(dict.fromkeys(damage)), tuple(unlisted))


def _listed_twice(manifests: Iterable[Manifest]) -> Iterator[Damage]:
    """Yield a `Damage` for each file, or range of rows in a shared file, that is listed for two runs."""
    claims: dict[str, list[tuple[int, int, str]]] = {}
    for manifest in manifests:
        for file in manifest.files:
            first = file.first or 0
            claims.setdefault(file.path, []).append((first, first + file.rows, manifest.run.run_id))
    for path, ranges in claims.items():
        end, last = 0, ""
        for first, after, run_id in sorted(ranges):
            if first < end:
                yield Damage(path, f"its rows from {first:,} on are also listed for run {last}", run_id)
            end, last = max((end, last), (after, run_id))


def _foreign_rows(store: Store, manifests: Iterable[Manifest]) -> Iterator[Damage]:
    """Yield a `Damage` for each run whose slice of a shared file is short or has rows of other runs."""
    shared: dict[str, list[tuple[PartFile, str]]] = {}
    for manifest in manifests:
        for file in manifest.files:
            if file.first is not None and file.rows:
                shared.setdefault(file.path, []).append((file, manifest.run.run_id))
    for path, slices in shared.items():
        try:
            ids = decode(slices[0][0].table, store.read_bytes(path), ["run_id"])["run_id"]
        except UNREADABLE:
            continue  # the error is already reported
        for file, run_id in slices:
            slice_ids = ids.slice(file.first, file.rows).cast(pa.string())
            if len(slice_ids) < file.rows or pc.unique(slice_ids).to_pylist() != [run_id]:
                yield Damage(path, f"rows {file.first:,} and following are not this run's", run_id)


def _tables_about_runs(store: Store) -> Iterator[Damage]:
    for table in (table for table in Table if table not in DATA_TABLES):
        for path in store.files(f"{layout.TABLES}/{table}"):
            try:
                decode(table, store.read_bytes(path))
            except UNREADABLE as error:
                yield Damage(path, damage_reason(error, store.where(path)))


def _foreign_policies(store: Store, manifests: Iterable[Manifest]) -> Iterator[Damage]:
    """Yield a `Damage` for each policy whose spec is unreadable or differs from its run's."""
    saved = set(store.files(layout.POLICIES))
    for manifest in manifests:
        path = f"{layout.policy_folder(manifest.run.run_id)}/{SPEC_FILE}"
        if path not in saved:
            continue
        try:
            saved_spec = decode_json(store.read_bytes(path), dict[str, Any], path)
        except UNREADABLE as error:
            yield Damage(path, damage_reason(error, store.where(path)), manifest.run.run_id)
            continue
        if saved_spec != decode_json(manifest.run.spec, dict[str, Any], path):
            yield Damage(path, "it is not the spec of its run", manifest.run.run_id)
