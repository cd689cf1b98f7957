"""A run's own side: rows in order, parts at checkpoints, one canonical file per table at the end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pyarrow as pa

from tma_ray.results.layout import final_path, part_number, part_path, staging_folder
from tma_ray.results.manifest import PartFile
from tma_ray.results.parquet import decode, encode
from tma_ray.results.schema import DATA_TABLES, SCHEMAS, Table, completed, to_arrow
from tma_ray.results.storage import Store


class RunWriter:
    """Write the rows of one attempt at a run, outside of readers' view.

    Rows are committed by a checkpoint that holds what `flush` returned; an attempt that resumes
    from it hands them back as `committed`, and later parts of the attempt before are never read.

    Args:
        store: the results root.
        run_id: id of the run.
        attempt: number of this attempt; no two processes may share one.
        committed: parts that belong to the run so far, of whatever attempt.

    Raises:
        ValueError: a committed part of another run.
    """

    def __init__(self, store: Store, run_id: str, attempt: int, committed: Sequence[PartFile] = ()) -> None:
        foreign = [part.path for part in committed if not part.path.startswith(staging_folder(run_id) + "/")]
        if foreign:
            raise ValueError(
                f"{foreign[0]} does not belong to run {run_id}: was the checkpoint another run's?"
            )
        self.store = store
        self.run_id = run_id
        self.attempt = attempt
        self._parts = tuple(committed)
        self._next = 1 + max((part_number(part.path) for part in committed), default=-1)
        self._buffer: dict[Table, list[pa.Table]] = {table: [] for table in DATA_TABLES}

    def add(self, table: Table, rows: Sequence[Mapping[str, Any]]) -> None:
        """Append rows; those of one evaluation belong in one call, so that no part holds half of it.

        Args:
            table: one of `DATA_TABLES`.
            rows: values by column name, without run_id; a nullable column may be left out.

        Raises:
            ValueError: a column missing, unknown, or of a wrong type; the message names it.
        """
        if table not in DATA_TABLES:
            raise ValueError(f"a run writes {', '.join(DATA_TABLES)}; {table} is written by the committer")
        # The first column, run_id, is ours to fill.
        self._buffer[table].append(to_arrow(table, SCHEMAS[table].remove(0), rows))

    def flush(self) -> tuple[PartFile, ...]:
        """Write the rows added since the last call as the next part; returns all parts of the run so far."""
        written = []
        for table, buffered in self._buffer.items():
            rows = pa.concat_tables(buffered) if buffered else None
            if rows is None or not len(rows):
                continue
            path = part_path(self.run_id, self.attempt, self._next, table)
            written.append(self._write(path, table, _with_run_id(self.run_id, rows)))
        if written:
            self._parts += tuple(written)
            self._next += 1
            self._buffer = {table: [] for table in DATA_TABLES}
        return self._parts

    def finish(self) -> tuple[PartFile, ...]:
        """Write and return the canonical files, one per data table, also for tables without rows.

        Their bytes depend on the rows only, not on how these were split over parts and attempts.

        Raises:
            FileNotFoundError: a part is gone.
            DamagedFileError: a part is not what was written.
        """
        files = []
        for table, buffered in self._buffer.items():
            schema = SCHEMAS[table]
            parts = [decode(table, part.read(self.store)) for part in self._parts if part.table is table]
            last = [_with_run_id(self.run_id, rows) for rows in buffered]
            parts += [completed(schema, schema.names, rows) for rows in last]
            path = final_path(self.run_id, self.attempt, table)
            files.append(self._write(path, table, pa.concat_tables([schema.empty_table(), *parts])))
        return tuple(files)

    def _write(self, path: str, table: Table, rows: pa.Table) -> PartFile:
        return PartFile.write(self.store, path, table, len(rows), encode(table, rows))


def _with_run_id(run_id: str, rows: pa.Table) -> pa.Table:
    return rows.add_column(0, "run_id", pa.array([run_id] * len(rows)))
