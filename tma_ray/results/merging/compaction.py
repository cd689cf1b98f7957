"""Merging the files of runs that are done: one per table and experiment, instead of one per table and run."""

from __future__ import annotations

import os
import socket
import warnings
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from tma_ray.decoding import DamagedFileWarning
from tma_ray.results.holding.lease import Lease
from tma_ray.results.inspection import Inspector
from tma_ray.results.layout import TABLES, check_root, manifest_path, table_path
from tma_ray.results.manifest import Manifest
from tma_ray.results.merging.copying import newer_version
from tma_ray.results.merging.journal import Journal, clean
from tma_ray.results.merging.packing import experiments_of, grouped, pack
from tma_ray.results.merging.shared_files import UNREADABLE
from tma_ray.results.parquet import decode
from tma_ray.results.reader import Results
from tma_ray.results.records import RunStatus
from tma_ray.results.schema import DATA_TABLES, Table
from tma_ray.results.storage.store import Store


@dataclass(frozen=True)
class Compaction:
    """Outcome of a compaction.

    Attributes:
        runs: whose files were merged.
        files_before: files of tables before.
        files_after: files of tables after.
        bytes_before: their size before.
        bytes_after: their size after.
    """

    runs: int
    files_before: int
    files_after: int
    bytes_before: int
    bytes_after: int


def compact(root: str | Path) -> Compaction:
    """Merges the files of all runs of a root that are done, experiment by experiment.

    The merged files are written aside, read back and compared; then one manifest after the other is
    switched to them, and what no manifest needs any more is deleted. A kill at any time leaves a root that
    reads the same, and the next call cleans up. Readers may go on; campaigns may not, and continue later.

    Runs that are damaged stay as they are, and so do those written by a newer version with columns that would
    be lost: a `DamagedFileWarning` names each.

    Args:
        root: a folder, or an ``s3://`` or ``gs://`` address.

    Raises:
        ResultsRootError: the root does not exist.
        RootInUseError: a campaign is running on it.
        DamagedFileError: a merged file was not written as it should be; nothing refers to it.
    """
    store = Store.open(root)
    check_root(store)
    with Lease(store, f"tma-ray compact (process {os.getpid()} on {socket.gethostname()})") as lease:
        clean(store)
        before = _files(store)
        results = Results(store)
        groups = grouped(list(_mergeable(results)), experiments_of(results))
        merged = 0
        for experiment, manifests in groups.items():
            if not _is_merged(manifests):
                _merge(results, manifests, experiment, lease)
                merged += len(manifests)
        after = _files(store)
    return Compaction(merged, len(before), len(after), sum(before.values()), sum(after.values()))


def _mergeable(results: Results) -> Iterator[Manifest]:
    """Yields the runs that are done and can be merged without loss; warns of others."""
    done = [manifest for manifest in results.runs() if manifest.status is RunStatus.DONE]
    for manifest, found in Inspector(results.store).inspect_all(done):
        for damage in found.damage:
            warnings.warn(f"{damage}; not merged", DamagedFileWarning, stacklevel=3)
        for path in found.newer:
            warnings.warn(newer_version(results.store, path), DamagedFileWarning, stacklevel=3)
        if not (found.damage or found.newer):
            yield manifest


def _merge(results: Results, manifests: Sequence[Manifest], experiment: str, lease: Lease) -> None:
    store = results.store
    name = _free_name(store, experiment, {manifest.run.run_id for manifest in results.runs()})
    new = [table_path(table, name) for table in (*DATA_TABLES, Table.RUNS, Table.ATTEMPTS)]
    old = [file.path for manifest in manifests for file in manifest.files]
    about = list(_only_about(store, {manifest.run.run_id for manifest in manifests}))
    kept = Journal.load(store).unless_used
    Journal((*kept, *new, *old)).write(store)
    packed = pack(results, manifests, store, name, lease.keep)
    Journal((*kept, *new[: len(DATA_TABLES)], *old), tuple(about)).write(store)
    lease.renew()
    for manifest in packed:
        lease.keep()
        store.write_bytes(manifest_path(manifest.run.run_id), manifest.to_bytes())
    clean(store)


def _only_about(store: Store, run_ids: Collection[str]) -> Iterator[str]:
    """Yields the files of the tables about runs that say nothing of any other run."""
    for table in (Table.RUNS, Table.ATTEMPTS):
        for path in store.files(f"{TABLES}/{table}"):
            try:
                said = decode(table, store.read_bytes(path), ["run_id"])["run_id"].unique().to_pylist()
            except UNREADABLE:
                continue  # readers name it
            if set(said) <= set(run_ids):
                yield path


def _is_merged(manifests: Sequence[Manifest]) -> bool:
    files = [file for manifest in manifests for file in manifest.files]
    shared = all(file.first is not None for file in files)
    return shared and len({file.path for file in files}) <= len(DATA_TABLES)


def _free_name(store: Store, experiment: str, run_ids: Collection[str]) -> str:
    count, name = 1, experiment
    while name in run_ids or any(
        store.exists(table_path(table, name)) for table in Table if table is not Table.CELLS
    ):
        count += 1
        name = f"{experiment}-{count}"
    return name


def _files(store: Store) -> dict[str, int]:
    return {path: store.size(path) for path in store.files(TABLES)}
