"""Run writers, which stage rows, and the committer, which publishes the rows in a results root."""

import json
import logging
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import Any, Final, Self

import pyarrow as pa

import tma_ray.results.layout as layout  # noqa: PLR0402 - this module is imported by the package
from tma_ray.results.manifest import UNREADABLE, Manifest, PartFile
from tma_ray.results.parquet import decode, encode
from tma_ray.results.records import AttemptOutcome, AttemptRecord, RunRecord, RunStatus
from tma_ray.results.schema import DATA_TABLES, SCHEMAS, Table, completed, to_arrow
from tma_ray.results.storage import StorageError, Store
from tma_ray.results.verification import Inspector
from tma_ray.support.decoding import DamagedFileError

TEMPORARY_SECONDS: Final = 3600.0  # age after which temporary files count as leftovers, s
ATTEMPT: Final = re.compile(r"attempt-(\d{1,9})")  # pattern of an attempt's number in file names

logger = logging.getLogger(__name__)


class StaleAttemptError(RuntimeError):
    """Error raised if an attempt tries to publish after a newer one has replaced it."""


def accepted_manifest(store: Store, run_id: str, attempt: int) -> Manifest | None:
    """Check that `attempt` may continue a run; return the run's manifest, None if missing or damaged.

    Raises:
        StaleAttemptError: if a later attempt is accepted, or the run is done.
    """
    published = _readable(store, run_id)
    if published is None:
        return None
    if published.status is RunStatus.DONE:
        raise StaleAttemptError(f"run {run_id} is done; attempt {attempt} may not publish")
    if published.attempt > attempt:
        raise StaleAttemptError(f"run {run_id}: attempt {attempt} is stale, {published.attempt} is accepted")
    return published


def _readable(store: Store, run_id: str) -> Manifest | None:
    """Return the manifest of a run, or None if it is missing or damaged; damage is logged."""
    try:
        return Manifest.load(store, run_id)
    except FileNotFoundError:
        return None
    except DamagedFileError as error:
        logger.warning("%s; it is written again", error)
        return None


WITHDRAWN: Final = b"null"  # content of the record of a withdrawn attempt


def write_progress(store: Store, record: AttemptRecord) -> None:
    """Write the record of a running attempt, which becomes its row if the attempt is lost."""
    content = {**asdict(record), "started_at": record.started_at.isoformat()}
    store.write_bytes(layout.progress_path(record.run_id, record.attempt), json.dumps(content).encode())


def read_progress(store: Store, run_id: str, attempt: int) -> AttemptRecord | None:
    """Return the last record of a running attempt, or None if it is missing or damaged."""
    path = layout.progress_path(run_id, attempt)
    try:
        record = store.read_json(path, AttemptRecord)
    except (FileNotFoundError, DamagedFileError):
        return None
    return record if (record.run_id, record.attempt) == (run_id, attempt) else None


class Committer:
    """Publisher of runs' results; a results root has at most one at a time.

    Every method can be repeated after a crash and then leads to the same files. Readers never see half of an
    evaluation or the same one twice, since files only become visible, or move, when a run's manifest is
    replaced.
    Publications raise a StaleAttemptError if a later attempt is accepted, or the run is done.

    Args:
        store: store of the root, which may not exist yet.

    Raises:
        ResultsRootError: if the store has other files or a root of another version.
    """

    def __init__(self, store: Store) -> None:
        layout.create_root(store)
        self.store = store

    @classmethod
    def open(cls, uri: str | Path) -> Self:
        """Return the committer of the root at a folder or URI, creating the root if nothing is there."""
        return cls(Store.open(uri))

    def manifest(self, run_id: str) -> Manifest | None:
        """Return the manifest of a run, or None if the run has published nothing."""
        try:
            return Manifest.load(self.store, run_id)
        except FileNotFoundError:
            return None

    def start(self, run: RunRecord) -> int:
        """Start a new attempt at a run, make older ones stale, and return the new attempt's number.

        Published results stay visible. The row of a previous attempt whose driver died is written here.
        """
        published = _readable(self.store, run.run_id)
        if published is not None:
            attempt = published.attempt + 1
        else:  # above all numbers in use, since two attempts must not write to the same files
            folders = [f"{name}/{run.run_id}" for name in (layout.STAGING, layout.CHECKPOINTS, layout.LOGS)]
            names = (path.removeprefix(f"{base}/") for base in folders for path in self.store.files(base))
            attempt = 1 + max((int(n) for name in names for n in ATTEMPT.findall(name)), default=-1)
        accepted_manifest(self.store, run.run_id, attempt)
        if published is not None and published.status is RunStatus.RUNNING:
            self._record_lost(run.run_id, published.attempt)
        files = published.files if published else ()
        self._replace(published, Manifest(run, RunStatus.RUNNING, attempt, files))
        return attempt

    def withdraw(self, run_id: str, attempt: int) -> None:
        """Withdraw an attempt that never began; it gets no row, and its number is not reused."""
        self.store.write_bytes(layout.progress_path(run_id, attempt), WITHDRAWN)

    def done(self, run_ids: Iterable[str]) -> set[str]:
        """Return the ids of the runs that are done and intact.

        Files are compared with their checksums. Damaged runs are logged and marked as failed, to be repeated.
        """
        readable = (_readable(self.store, run_id) for run_id in run_ids)
        published = [manifest for manifest in readable if manifest and manifest.status is RunStatus.DONE]
        whole = set()
        for manifest, inspection in Inspector(self.store).inspect_all(published):
            if inspection.damage:
                logger.warning("%s; the run is done again", inspection.damage[0])
                error = f"it was done, and is damaged: {inspection.damage[0]}"
                self._replace(manifest, Manifest(manifest.run, RunStatus.FAILED, manifest.attempt, (), error))
            else:
                whole.add(manifest.run.run_id)
        return whole

    def publish(self, run: RunRecord, attempt: int, parts: Sequence[PartFile]) -> None:
        """Publish all `parts` of a run so far, after a checkpoint that refers to them."""
        published = accepted_manifest(self.store, run.run_id, attempt)
        visible = set(published.files) if published else set()
        for part in parts:
            if part not in visible and not self.store.exists(part.path):
                raise FileNotFoundError(f"{self.store.where(part.path)} is not there; nothing was published")
        self._replace(published, Manifest(run, RunStatus.RUNNING, attempt, tuple(parts)))

    def finish(self, run: RunRecord, attempt: int, final: Sequence[PartFile]) -> None:
        """Publish the policy and the files from `RunWriter.finish`, then remove the staging folder.

        Raises:
            FileNotFoundError: if a file is neither staged nor published.
            DamagedFileError: if a file is damaged.
        """
        if sorted(file.table for file in final) != sorted(DATA_TABLES):
            raise ValueError(f"a run ends with one file for each of {', '.join(DATA_TABLES)}; got {final}")
        moved = tuple(replace(file, path=layout.table_path(file.table, run.run_id)) for file in final)
        done = Manifest(run, RunStatus.DONE, attempt, moved)
        published = _readable(self.store, run.run_id)
        if published != done:
            published = accepted_manifest(self.store, run.run_id, attempt)
            for source, destination in zip(final, moved, strict=True):
                if self.store.exists(source.path):
                    source.read(self.store)
                    self.store.move(source.path, destination.path)
                else:
                    destination.read(self.store)  # already moved if an earlier call was interrupted
            for path in self.store.files(layout.staged_policy(run.run_id, attempt)):
                self.store.move(path, f"{layout.policy_folder(run.run_id)}/{PurePosixPath(path).name}")
            self._replace(published, done)
        self._record_done(run.run_id, attempt)
        self.store.delete(layout.staging_folder(run.run_id))

    def fail(self, run: RunRecord, attempt: int, error: str) -> None:
        """Mark a run as failed; a later attempt may continue it."""
        published = accepted_manifest(self.store, run.run_id, attempt)
        files = published.files if published else ()
        self._replace(published, Manifest(run, RunStatus.FAILED, attempt, files, error))

    def record_attempt(self, record: AttemptRecord) -> None:
        """Write or replace the row of an attempt."""
        row = {**asdict(record), "outcome": record.outcome.value}
        self._merge(Table.ATTEMPTS, record.run_id, [row], key=("attempt",))

    def write_cells(self, campaign: str, rows: Sequence[Mapping[str, Any]]) -> None:
        """Write the cells of a campaign and their runs, keeping the campaign's cells from earlier calls."""
        key = tuple(name for name in SCHEMAS[Table.CELLS].names if name != "run_id")
        self._merge(Table.CELLS, campaign, [{"campaign": campaign, **row} for row in rows], key)

    def sweep(self) -> None:
        """Remove temporary files, and the staging folders and checkpoints of runs that are done."""
        self.store.clear_temporaries(TEMPORARY_SECONDS)
        for folder in (layout.STAGING, layout.CHECKPOINTS):
            for run_id in sorted({PurePosixPath(path).parts[1] for path in self.store.files(folder)}):
                published = _readable(self.store, run_id)
                if published is not None and published.status is RunStatus.DONE:
                    self._record_done(run_id, published.attempt)
                    self.store.delete(f"{folder}/{layout.check_id(run_id)}")

    def _record_lost(self, run_id: str, attempt: int) -> None:
        """Write the row of an attempt whose driver died, unless the row exists."""
        path = layout.progress_path(run_id, attempt)
        if self._has_row(run_id, attempt):
            return
        if self.store.exists(path) and self.store.read_bytes(path) == WITHDRAWN:
            return
        record = read_progress(self.store, run_id, attempt)
        if record is None:  # take the modification time of the manifest as the start
            written_at, _ = self.store.stamps(layout.MANIFESTS).get(
                layout.manifest_path(run_id), (None, None)
            )
            started_at = datetime.fromtimestamp(written_at / 1e9, UTC) if written_at else datetime.now(UTC)
            record = AttemptRecord(run_id, attempt, started_at, 0.0, 0.0, "", "{}", AttemptOutcome.LOST)
        self.record_attempt(record)

    def _record_done(self, run_id: str, attempt: int) -> None:
        """Write the row of the attempt that finished a run, unless the row exists.

        The attempt's driver may die before writing it.
        """
        record = read_progress(self.store, run_id, attempt)
        if record is not None and not self._has_row(run_id, attempt):
            self.record_attempt(replace(record, outcome=AttemptOutcome.DONE))

    def _has_row(self, run_id: str, attempt: int) -> bool:
        path = layout.table_path(Table.ATTEMPTS, run_id)
        return any(row["attempt"] == attempt for row in self._rows_before(Table.ATTEMPTS, path))

    def _replace(self, published: Manifest | None, new: Manifest) -> None:
        """Write the row of a run, and then its manifest, since a manifest must never lack a row."""
        if published is None or published.row() != new.row():
            row = to_arrow(Table.RUNS, SCHEMAS[Table.RUNS], [new.row()])
            self.store.write_bytes(layout.table_path(Table.RUNS, new.run.run_id), encode(Table.RUNS, row))
        if published != new:
            self.store.write_bytes(layout.manifest_path(new.run.run_id), new.to_bytes())

    def _merge(
        self, table: Table, name: str, rows: Sequence[Mapping[str, Any]], key: tuple[str, ...]
    ) -> None:
        path = layout.table_path(table, name)
        before = self._rows_before(table, path)
        to_arrow(table, SCHEMAS[table], rows)  # checks the columns before merging
        merged = {tuple(row[column] for column in key): row for row in [*before, *rows]}
        ordered = [merged[identity] for identity in sorted(merged)]
        self.store.write_bytes(path, encode(table, to_arrow(table, SCHEMAS[table], ordered)))

    def _rows_before(self, table: Table, path: str) -> list[dict[str, Any]]:
        """Return the rows of a file to be replaced, none if it is missing or damaged; damage is logged."""
        try:
            rows: list[dict[str, Any]] = decode(table, self.store.read_bytes(path)).to_pylist()
        except FileNotFoundError:
            return []
        except UNREADABLE as error:
            if isinstance(error, StorageError):
                raise
            logger.warning("%s is damaged and is written again: %s", self.store.where(path), error)
            return []
        return rows


class RunWriter:
    """Writer that stages the rows of one attempt at a run.

    A checkpoint commits rows by storing the result of `flush`; a resuming attempt passes it as `committed`.

    Args:
        store: store of the results root.
        run_id: id of the run.
        attempt: number of this attempt, unique to this process.
        committed: parts of the run so far, by any attempt.

    Raises:
        ValueError: if a committed part belongs to another run.
    """

    def __init__(self, store: Store, run_id: str, attempt: int, committed: Sequence[PartFile] = ()) -> None:
        folder = layout.staging_folder(run_id) + "/"
        foreign = [part.path for part in committed if not part.path.startswith(folder)]
        if foreign:
            raise ValueError(
                f"{foreign[0]} does not belong to run {run_id}: was the checkpoint another run's?"
            )
        self.store = store
        self.run_id = run_id
        self.attempt = attempt
        self._parts = tuple(committed)
        self._next = 1 + max((layout.part_number(part.path) for part in committed), default=-1)
        self._buffer: dict[Table, list[pa.Table]] = {table: [] for table in DATA_TABLES}

    def add(self, table: Table, rows: Sequence[Mapping[str, Any]]) -> None:
        """Append rows; the rows of an evaluation must come in one call, since parts hold whole evaluations.

        Args:
            table: one of `DATA_TABLES`.
            rows: values by column name, without run_id; nullable columns may be missing.

        Raises:
            ValueError: if a column is missing, unknown, or of a wrong type.
        """
        if table not in DATA_TABLES:
            raise ValueError(f"a run writes {', '.join(DATA_TABLES)}; {table} is written by the committer")
        self._buffer[table].append(to_arrow(table, SCHEMAS[table].remove(0), rows))  # leaves out run_id

    def flush(self) -> tuple[PartFile, ...]:
        """Write the rows added since the last call as a new part, and return all parts of the run so far."""
        written = []
        for table, buffered in self._buffer.items():
            rows = pa.concat_tables(buffered) if buffered else None
            if rows is None or not len(rows):
                continue
            path = layout.part_path(self.run_id, self.attempt, self._next, table)
            written.append(self._write(path, table, _with_run_id(self.run_id, rows)))
        if written:
            self._parts += tuple(written)
            self._next += 1
            self._buffer = {table: [] for table in DATA_TABLES}
        return self._parts

    def finish(self) -> tuple[PartFile, ...]:
        """Write and return one canonical file per data table, with bytes that depend only on the rows.

        Raises:
            FileNotFoundError: if a part is missing.
            DamagedFileError: if a part is damaged.
        """
        files = []
        for table, buffered in self._buffer.items():
            schema = SCHEMAS[table]
            parts = [decode(table, part.read(self.store)) for part in self._parts if part.table is table]
            last = [_with_run_id(self.run_id, rows) for rows in buffered]
            parts += [completed(schema, schema.names, rows) for rows in last]
            path = layout.final_path(self.run_id, self.attempt, table)
            files.append(self._write(path, table, pa.concat_tables([schema.empty_table(), *parts])))
        return tuple(files)

    def _write(self, path: str, table: Table, rows: pa.Table) -> PartFile:
        return PartFile.write(self.store, path, table, len(rows), encode(table, rows))


def _with_run_id(run_id: str, rows: pa.Table) -> pa.Table:
    return rows.add_column(0, "run_id", pa.array([run_id] * len(rows)))
