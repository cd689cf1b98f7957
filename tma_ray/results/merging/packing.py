"""Tables of many runs as one file each: written, read back and compared before anybody relies on them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import pyarrow as pa

from tma_ray.decoding import DamagedFileError
from tma_ray.results.layout import table_path
from tma_ray.results.manifest import Manifest, PartFile
from tma_ray.results.parquet import decode_rows, encode, encode_together, same_rows
from tma_ray.results.reader import Results
from tma_ray.results.schema import DATA_TABLES, SCHEMAS, Table
from tma_ray.results.storage.store import Store

SINGLE_RUNS = "single_runs"
"""Name of the files of runs that belong to no experiment."""


@dataclass(frozen=True)
class Contents:
    """Contents of a copy of a root.

    Attributes:
        tables: which tables that runs write.
        unfinished: whether runs that are not done are copied.
        policies: whether final policies are copied.
        hosts: whether attempts name the machines that they were made on.
    """

    tables: tuple[Table, ...] = DATA_TABLES
    unfinished: bool = True
    policies: bool = True
    hosts: bool = True


WHOLE: Final = Contents()
"""All that a root says of its runs."""

LEAN: Final = Contents(
    (Table.EVALUATIONS, Table.TRAINING, Table.CURRICULUM), unfinished=False, policies=False, hosts=False
)
"""Some 20 kB a run: neither episodes, logs of teachers and policies, nor names of machines."""


def experiments_of(results: Results) -> dict[str, str]:
    """Returns the experiment of each run by id, as file names have it; of several the first by name."""
    cells = results.table(Table.CELLS, columns=["experiment", "run_id"]).to_pylist()
    found = {
        cell["run_id"]: cell["experiment"]
        for cell in sorted(cells, key=lambda c: c["experiment"], reverse=True)
    }
    ids = (manifest.run.run_id for manifest in results.runs())
    return {
        run_id: re.sub(r"[^0-9a-zA-Z_-]", "_", found.get(run_id, SINGLE_RUNS)) or SINGLE_RUNS
        for run_id in ids
    }


def grouped(manifests: Sequence[Manifest], experiments: Mapping[str, str]) -> dict[str, list[Manifest]]:
    """Returns `manifests` by experiment, each group by run id."""
    groups: dict[str, list[Manifest]] = {}
    for manifest in sorted(manifests, key=lambda manifest: manifest.run.run_id):
        groups.setdefault(experiments[manifest.run.run_id], []).append(manifest)
    return dict(sorted(groups.items()))


def pack(
    results: Results,
    manifests: Sequence[Manifest],
    target: Store,
    name: str,
    tick: Callable[[], None],
    contents: Contents = WHOLE,
) -> list[Manifest]:
    """Writes one file per table with all rows of some runs; returns manifests that lead to them.

    The rows come run after run, each run's as they were written: in order of steps. Nothing refers to the
    files yet when it returns; they have been read back and compared with what they were made of.

    Args:
        results: the root that the runs are read from.
        manifests: of these runs, by run id.
        target: the root to write to, perhaps the same.
        name: of the files; none of that name may be there.
        tick: called now and then, as long work needs signs of life.
        contents: what is written of the runs.

    Raises:
        DamagedFileError: rows cannot be read, or were not written as they are.
    """
    slices: dict[str, list[PartFile]] = {manifest.run.run_id: [] for manifest in manifests}
    for table in contents.tables:
        for run_id, file in _pack_table(results, list(slices), target, (table, name), tick):
            slices[run_id].append(file)
    for table in (Table.RUNS, Table.ATTEMPTS):
        rows, path = results.table(table, list(slices)), table_path(table, name)
        if table is Table.ATTEMPTS and not contents.hosts:
            rows = _without_hosts(rows)
        PartFile.write(target, path, table, len(rows), encode(table, rows)).read(target)
    return [replace(manifest, files=tuple(slices[manifest.run.run_id])) for manifest in manifests]


def _without_hosts(attempts: pa.Table) -> pa.Table:
    place = attempts.schema.get_field_index("host")
    field = attempts.schema.field(place)
    empty = pa.array([""] * len(attempts), pa.string()).dictionary_encode().cast(field.type)
    return attempts.set_column(place, field, empty)


def _rows_of(results: Results, table: Table, run_id: str) -> pa.Table:
    """Returns the rows of one run.

    Raises:
        DamagedFileError: some cannot be read.
    """
    before = len(results.problems)
    rows = results.table(table, [run_id])
    if len(results.problems) > before:
        raise DamagedFileError(f"nothing was merged: {results.problems[before]}")
    return rows


def _pack_table(
    results: Results,
    run_ids: Sequence[str],
    target: Store,
    place: tuple[Table, str],
    tick: Callable[[], None],
) -> Iterator[tuple[str, PartFile]]:
    table, name = place
    counts: dict[str, int] = {}

    def parts() -> Iterator[pa.Table]:
        for run_id in run_ids:
            tick()
            rows = _rows_of(results, table, run_id)
            counts[run_id] = len(rows)
            yield rows

    data, path = encode_together(table, parts()), table_path(table, name)
    if target.exists(path):
        raise DamagedFileError(f"{target.where(path)} is there already; nothing was merged")
    written = PartFile.write(target, path, table, sum(counts.values()), data)
    stored, first = pa.BufferReader(written.read(target)), 0
    for run_id in run_ids:
        tick()
        expected = _rows_of(results, table, run_id)
        found = (
            decode_rows(table, stored, first, counts[run_id], SCHEMAS[table].names)
            if counts[run_id]
            else expected
        )
        if not same_rows(table, found, expected):
            raise DamagedFileError(
                f"{target.where(path)} does not hold what run {run_id} wrote; nothing was merged"
            )
        yield run_id, replace(written, rows=counts[run_id], first=first)
        first += counts[run_id]
