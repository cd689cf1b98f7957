"""The one publisher of a results root: it decides which attempt counts and what readers see."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path, PurePosixPath
from typing import Any, Final, Self

from tma_ray.results.layout import (
    CHECKPOINTS,
    STAGING,
    check_id,
    create_root,
    manifest_path,
    policy_folder,
    staged_policy,
    staging_folder,
    table_path,
)
from tma_ray.results.manifest import DamagedFileError, Manifest, PartFile
from tma_ray.results.parquet import decode, encode
from tma_ray.results.records import AttemptRecord, RunRecord, RunStatus
from tma_ray.results.rows import to_arrow
from tma_ray.results.schema import DATA_TABLES, SCHEMAS, Table
from tma_ray.results.storage.store import Store

TEMPORARY_SECONDS: Final = 3600.0
"""Age over which a half-made file is taken to be left by a killed process, s."""


class StaleAttemptError(RuntimeError):
    """An attempt that no longer counts tried to publish; its process should end."""


def accepted_manifest(store: Store, run_id: str, attempt: int) -> Manifest | None:
    """Returns what a run has published, None if nothing, as long as `attempt` may go on with it.

    Raises:
        StaleAttemptError: a later attempt is accepted, or the run is done.
        DamagedFileError: the manifest cannot be read.
    """
    try:
        published = Manifest.load(store, run_id)
    except FileNotFoundError:
        return None
    if published.status is RunStatus.DONE:
        raise StaleAttemptError(f"run {run_id} is done; attempt {attempt} may not publish")
    if published.attempt > attempt:
        raise StaleAttemptError(f"run {run_id}: attempt {attempt} is stale, {published.attempt} is accepted")
    return published


class Committer:
    """Publishes runs. A results root has one committer at a time; its readers need none.

    Every method may be called again after a kill in the middle of it, and then leads to the same
    files. Between any two file operations readers see each evaluation once and whole: data becomes
    visible, and changes place, by the replacement of the run's manifest alone.

    Args:
        store: where the root is, or is to be made.

    Raises:
        ResultsRootError: other files are there, or a root of another version.
    """

    def __init__(self, store: Store) -> None:
        create_root(store)
        self.store = store

    @classmethod
    def open(cls, uri: str | Path) -> Self:
        """Returns the committer of the root at a folder or URI, which is made if it is empty."""
        return cls(Store.open(uri))

    def manifest(self, run_id: str) -> Manifest | None:
        """Returns what a run has published, None if nothing.

        Raises:
            DamagedFileError: the manifest cannot be read.
        """
        try:
            return Manifest.load(self.store, run_id)
        except FileNotFoundError:
            return None

    def start(self, run: RunRecord) -> int:
        """Returns the number of a new attempt at a run; from here on older ones publish nothing.

        What the run has published stays visible until the attempt publishes.

        Raises:
            StaleAttemptError: the run is done.
        """
        published = self.manifest(run.run_id)
        attempt = published.attempt + 1 if published else 0
        self._accept(run.run_id, attempt)
        files = published.files if published else ()
        self._replace(published, Manifest(run, RunStatus.RUNNING, attempt, files))
        return attempt

    def publish(self, run: RunRecord, attempt: int, parts: Sequence[PartFile]) -> None:
        """Makes the parts of a committed checkpoint the visible rows of the run.

        Args:
            run: what the run is.
            attempt: which attempt reports.
            parts: all parts of the run so far, in order.

        Raises:
            StaleAttemptError: a later attempt is accepted, or the run is done.
            FileNotFoundError: a part is not there.
        """
        published = self._accept(run.run_id, attempt)
        known = set(published.files) if published else set()
        for part in parts:
            if part not in known and not self.store.exists(part.path):
                raise FileNotFoundError(f"{self.store.where(part.path)} is not there; nothing was published")
        self._replace(published, Manifest(run, RunStatus.RUNNING, attempt, tuple(parts)))

    def finish(self, run: RunRecord, attempt: int, final: Sequence[PartFile]) -> None:
        """Publishes canonical files and policy of a run that has ended, then removes its staging folder.

        Args:
            run: what the run is.
            attempt: which attempt reports.
            final: what `RunWriter.finish` returned, one file per data table.

        Raises:
            StaleAttemptError: a later attempt is accepted, or another one has finished the run.
            FileNotFoundError: a file is neither staged nor published.
            DamagedFileError: a file is not what was written.
        """
        if sorted(file.table for file in final) != sorted(DATA_TABLES):
            raise ValueError(f"a run ends with one file for each of {', '.join(DATA_TABLES)}; got {final}")
        moved = tuple(file.at(table_path(file.table, run.run_id)) for file in final)
        done = Manifest(run, RunStatus.DONE, attempt, moved)
        published = self.manifest(run.run_id)
        if published != done:
            published = self._accept(run.run_id, attempt)
            for source, destination in zip(final, moved, strict=True):
                if self.store.exists(source.path):
                    source.read(self.store)
                    self.store.move(source.path, destination.path)
                else:
                    destination.read(self.store)  # moved before a kill
            self._move_policy(run.run_id, attempt)
            self._replace(published, done)
        self.store.delete(staging_folder(run.run_id))

    def fail(self, run: RunRecord, attempt: int, error: str) -> None:
        """Marks a run as failed; what it has published stays, and a later attempt may take it up again.

        Raises:
            StaleAttemptError: a later attempt is accepted, or the run is done.
        """
        published = self._accept(run.run_id, attempt)
        files = published.files if published else ()
        self._replace(published, Manifest(run, RunStatus.FAILED, attempt, files, error))

    def record_attempt(self, record: AttemptRecord) -> None:
        """Writes the row of an attempt, replacing an earlier one of the same number."""
        row = {**asdict(record), "outcome": record.outcome.value}
        self._merge(Table.ATTEMPTS, record.run_id, [row], key=("attempt",))

    def write_cells(self, campaign: str, rows: Sequence[Mapping[str, Any]]) -> None:
        """Writes the cells of a campaign and their runs.

        Cells that the campaign has written before and that are not among `rows` stay: a campaign
        may be run teacher by teacher.

        Args:
            campaign: name of the campaign.
            rows: columns of the table but campaign.
        """
        key = tuple(name for name in SCHEMAS[Table.CELLS].names if name != "run_id")
        self._merge(Table.CELLS, campaign, [{"campaign": campaign, **row} for row in rows], key)

    def sweep(self) -> None:
        """Removes what kills and stale attempts left: half-made files; all but the results of runs done."""
        self.store.clear_temporaries(TEMPORARY_SECONDS)
        for place in (STAGING, CHECKPOINTS):
            for run_id in sorted({PurePosixPath(path).parts[1] for path in self.store.files(place)}):
                published = self._readable_manifest(run_id)
                if published is not None and published.status is RunStatus.DONE:
                    self.store.delete(f"{place}/{check_id(run_id)}")

    def _readable_manifest(self, run_id: str) -> Manifest | None:
        try:
            return self.manifest(run_id)
        except DamagedFileError:
            return None

    def _accept(self, run_id: str, attempt: int) -> Manifest | None:
        return accepted_manifest(self.store, run_id, attempt)

    def _move_policy(self, run_id: str, attempt: int) -> None:
        for path in self.store.files(staged_policy(run_id, attempt)):
            self.store.move(path, f"{policy_folder(run_id)}/{PurePosixPath(path).name}")

    def _replace(self, published: Manifest | None, new: Manifest) -> None:
        """Writes the run's row, then its manifest, so that a manifest never stands without its row."""
        if published is None or published.row() != new.row():
            row = to_arrow(Table.RUNS, SCHEMAS[Table.RUNS], [new.row()])
            self.store.write_bytes(table_path(Table.RUNS, new.run.run_id), encode(Table.RUNS, row))
        if published != new:
            self.store.write_bytes(manifest_path(new.run.run_id), new.to_bytes())

    def _merge(
        self, table: Table, name: str, rows: Sequence[Mapping[str, Any]], key: tuple[str, ...]
    ) -> None:
        path = table_path(table, name)
        before = decode(self.store.read_bytes(path)).to_pylist() if self.store.exists(path) else []
        to_arrow(table, SCHEMAS[table], rows)  # refuses wrong columns before they are merged
        merged = {tuple(row[column] for column in key): row for row in [*before, *rows]}
        ordered = [merged[identity] for identity in sorted(merged)]
        self.store.write_bytes(path, encode(table, to_arrow(table, SCHEMAS[table], ordered)))
