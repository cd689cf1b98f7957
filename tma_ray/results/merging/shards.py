"""Roots that grow by shards, a file per table for each batch, and batches that begin with such a root."""

from __future__ import annotations

import os
import socket
from dataclasses import dataclass
from typing import Any

from tma_ray.results.holding.lease import Lease
from tma_ray.results.layout import (
    INPUTS,
    TABLES,
    check_root,
    create_root,
    manifest_path,
    table_path,
)
from tma_ray.results.manifest import Manifest
from tma_ray.results.merging.copying import copy_beside, sound_runs
from tma_ray.results.merging.packing import LEAN, Contents, pack
from tma_ray.results.parquet import encode
from tma_ray.results.reader import Results
from tma_ray.results.records import RunStatus
from tma_ray.results.rows import to_arrow
from tma_ray.results.schema import DATA_TABLES, SCHEMAS, Table
from tma_ray.results.storage.errors import ResultsRootError
from tma_ray.results.storage.store import Store


@dataclass(frozen=True)
class Shard:
    """Additions of one batch.

    Attributes:
        runs: how many were added.
        cells: how many rows the table of cells got.
        policy_files: that were left out, since they are neither JSON nor safetensors.
        damaged: a message for each run that was left out, since it is damaged.
    """

    runs: int
    cells: int
    policy_files: tuple[str, ...]
    damaged: tuple[str, ...]


def add_shard(results: Results, target: Store, name: str, contents: Contents = LEAN) -> Shard:
    """Adds to a root those runs of another that are done and that it lacks, with their cells.

    No file that is there is changed: each table gets one file called `name`, each run its manifest.

    Args:
        results: the root of the batch, which may have begun with the runs of `target`.
        target: the root that grows; an empty place becomes one.
        name: of the new files; letters, digits, "_" and "-".
        contents: what is copied.

    Raises:
        ResultsRootError: `target` is not a results root, or has files of that name.
        DamagedFileError: a file was written by a newer version, with columns that would be lost.
    """
    create_root(target)
    before = Results(target)
    known = {manifest.run.run_id for manifest in before.runs()}
    for table in Table:
        if target.exists(table_path(table, name)):
            raise ResultsRootError(f"{target.where(table_path(table, name))} exists: choose another name")
    sound, damaged = sound_runs(results, contents)
    new = [manifest for manifest in sound if manifest.run.run_id not in known]
    cells = _new_cells(results, before, known | {manifest.run.run_id for manifest in new})
    if new:
        for manifest in pack(results, new, target, name, lambda: None, contents):
            target.write_bytes(manifest_path(manifest.run.run_id), manifest.to_bytes())
    if cells:
        rows = to_arrow(Table.CELLS, SCHEMAS[Table.CELLS], cells)
        target.write_bytes(table_path(Table.CELLS, name), encode(Table.CELLS, rows))
    unsafe = copy_beside(results, target, new, contents)
    return Shard(len(new), len(cells), unsafe, tuple(dict.fromkeys([*results.problems, *damaged])))


def start_from(store: Store, source: Store) -> int:
    """Copies the runs of a root that are done, with their cells, to another that lacks them.

    A campaign on that root takes them as its own, and does what is missing. Files keep their paths.

    Args:
        store: the root to begin with; an empty place becomes one.
        source: a results root or a release.

    Returns:
        How many runs were copied.

    Raises:
        ResultsRootError: `source` is not a results root, or a file of that path and another content is there.
        RootInUseError: a campaign is running on `store`.
    """
    check_root(source)
    create_root(store)
    with Lease(store, f"start from {source} (process {os.getpid()} on {socket.gethostname()})") as lease:
        there = {manifest.run.run_id for manifest in Results(store).runs()}
        done = [run for run in Results(source).runs() if run.status is RunStatus.DONE]
        new = [manifest for manifest in done if manifest.run.run_id not in there]
        for path in _files_of(source, new):
            lease.keep()
            _copy_file(source, store, path)
        for manifest in new:  # last: a run is there when its manifest is
            _copy_file(source, store, manifest_path(manifest.run.run_id))
    return len(new)


def _new_cells(results: Results, before: Results, run_ids: set[str]) -> list[dict[str, Any]]:
    """Returns the rows of cells that `before` lacks and whose runs are among `run_ids`, each once, sorted."""
    names = SCHEMAS[Table.CELLS].names
    known = {tuple(row.values()) for row in before.table(Table.CELLS).to_pylist()}
    found = {tuple(row.values()) for row in results.table(Table.CELLS, run_ids).to_pylist()}
    return [dict(zip(names, row, strict=True)) for row in sorted(found - known)]


def _files_of(source: Store, manifests: list[Manifest]) -> list[str]:
    """Returns the paths of all that a root says of some runs, but their manifests."""
    if not manifests:
        return []
    files = {file.path for manifest in manifests for file in manifest.files}
    tables = (table for table in Table if table not in DATA_TABLES)
    about = {path for table in tables for path in source.files(f"{TABLES}/{table}")}
    return sorted(files | about | set(source.files(INPUTS)))


def _copy_file(source: Store, target: Store, path: str) -> None:
    data = source.read_bytes(path)
    if not target.exists(path):
        target.write_bytes(path, data)
    elif target.read_bytes(path) != data:
        raise ResultsRootError(
            f"{target.where(path)} differs from {source.where(path)}: begin in a new folder"
        )
