"""Merging the files of runs that are done: one per table and experiment, instead of one per table and run."""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Final

from tma_ray.results.layout import POLICIES, TABLES, check_root, create_root, manifest_path, table_path
from tma_ray.results.lease import Lease
from tma_ray.results.manifest import DamagedFileError, Manifest
from tma_ray.results.merging.packing import experiments_of, grouped, pack, rows_about
from tma_ray.results.parquet import decode, encode
from tma_ray.results.reader import Results
from tma_ray.results.records import RunStatus
from tma_ray.results.schema import DATA_TABLES, Table
from tma_ray.results.storage.store import Store

JOURNAL: Final = "compacting.json"
"""Lists what a compaction leaves without use: files that it replaces, or its own if it is interrupted."""

POLICY_FILES: Final = (".json", ".safetensors")
"""Endings of the files of policies that are copied: nothing that runs when it is read."""


@dataclass(frozen=True)
class Compaction:
    """What a compaction came to.

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

    Args:
        root: a folder, or an ``s3://`` or ``gs://`` address.

    Raises:
        ResultsRootError: the root does not exist.
        RootInUseError: a campaign is running on it.
        DamagedFileError: a file cannot be read; nothing of its experiment was changed.
    """
    store = Store.open(root)
    check_root(store)
    with Lease(store, f"tma-ray compact (process {os.getpid()} on {socket.gethostname()})") as lease:
        _clean(store)
        before = _files(store)
        results = _sound(store)
        done = [manifest for manifest in results.runs() if manifest.status is RunStatus.DONE]
        groups = grouped(done, experiments_of(results))
        merged = 0
        for experiment, manifests in groups.items():
            if not _is_merged(manifests):
                _merge(results, manifests, experiment, lease)
                merged += len(manifests)
        after = _files(store)
    return Compaction(merged, len(before), len(after), sum(before.values()), sum(after.values()))


def copy_merged(results: Results, target: Store) -> list[str]:
    """Copies all that a root says of its runs, and their policies, to an empty place, files merged.

    Args:
        results: the root.
        target: where another one is made.

    Returns:
        Files of policies that were left out, since they are neither JSON nor safetensors.

    Raises:
        DamagedFileError: a file of the root cannot be read.
        ResultsRootError: `target` is not empty.
    """
    if results.problems:
        raise DamagedFileError(f"nothing was copied: {results.problems[0]}")
    create_root(target)
    for name, manifests in grouped(results.runs(), experiments_of(results)).items():
        for manifest in pack(results, manifests, target, name, lambda: None):
            target.write_bytes(manifest_path(manifest.run.run_id), manifest.to_bytes())
    rows_about(results, Table.CELLS)  # refuses damaged files
    for path in results.store.files(f"{TABLES}/{Table.CELLS}"):
        target.write_bytes(path, encode(Table.CELLS, decode(results.store.read_bytes(path))))
    ours = {manifest.run.run_id for manifest in results.runs()}
    left_out = []
    for path in results.store.files(POLICIES):
        if path.endswith(POLICY_FILES) and PurePosixPath(path).parts[1] in ours:
            target.write_bytes(path, results.store.read_bytes(path))
        else:
            left_out.append(path)
    return left_out


def _merge(results: Results, manifests: Sequence[Manifest], experiment: str, lease: Lease) -> None:
    store = results.store
    name = _free_name(store, experiment, {manifest.run.run_id for manifest in results.runs()})
    new = [table_path(table, name) for table in (*DATA_TABLES, Table.RUNS, Table.ATTEMPTS)]
    old = [file.path for manifest in manifests for file in manifest.files]
    about = list(_only_about(store, {manifest.run.run_id for manifest in manifests}))
    _note(store, [*new, *old], [])
    packed = pack(results, manifests, store, name, lease.keep)
    _note(store, [*new[: len(DATA_TABLES)], *old], about)
    lease.renew()
    for manifest in packed:
        lease.keep()
        store.write_bytes(manifest_path(manifest.run.run_id), manifest.to_bytes())
    _clean(store)


def _note(store: Store, unless_used: Sequence[str], replaced: Sequence[str]) -> None:
    """Writes what is to be deleted in the end, by this call or, if it is killed, by the next."""
    content = {"unless_used": sorted(set(unless_used)), "replaced": replaced}
    store.write_bytes(JOURNAL, json.dumps(content).encode())


def _clean(store: Store) -> None:
    """Deletes what the journal lists and no manifest needs."""
    if not store.exists(JOURNAL):
        return
    journal = json.loads(store.read_bytes(JOURNAL))
    used = {file.path for manifest in _sound(store).runs() for file in manifest.files}
    for path in (*(path for path in journal["unless_used"] if path not in used), *journal["replaced"]):
        store.delete(path)
    store.delete(JOURNAL)


def _only_about(store: Store, run_ids: Collection[str]) -> Iterator[str]:
    """Yields the files of the tables about runs that say nothing of any other run."""
    for table in (Table.RUNS, Table.ATTEMPTS):
        for path in store.files(f"{TABLES}/{table}"):
            if PurePosixPath(path).stem not in run_ids:
                said = decode(store.read_bytes(path), ["run_id"])["run_id"].unique().to_pylist()
                if not set(said) <= set(run_ids):
                    continue
            yield path


def _sound(store: Store) -> Results:
    """Returns the results of a root whose manifests can all be read.

    Raises:
        DamagedFileError: one cannot; whatever it refers to would be lost.
    """
    results = Results(store)
    if results.problems:
        raise DamagedFileError(f"nothing was merged: {results.problems[0]}")
    return results


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
