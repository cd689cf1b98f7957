"""Attempts at runs, their logs, and the execution of runs in this process."""

import json
import logging
import platform
import tempfile
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from tma_ray.results import (
    AttemptOutcome,
    AttemptRecord,
    Committer,
    PartFile,
    RunWriter,
    StorageError,
    Store,
    accepted_manifest,
    log_path,
    retry,
    staged_policy,
    write_progress,
)
from tma_ray.runs.checkpoints import Checkpoints
from tma_ray.runs.inputs import RunInputs, fetch
from tma_ray.runs.placement import Placement, Status, fingerprint, gpu
from tma_ray.runs.run import Run
from tma_ray.runs.spec import RunSpec
from tma_ray.runs.teaching import InlineTeacher, TeacherLink
from tma_ray.students.rollout_workers import LearnerLostError, ask_learner
from tma_ray.support.validation import check_type

RECENT_EPISODES = 100  # number of training episodes over which a `Status` averages the return

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Report:
    """Progress of an attempt, for the process that commits its results.

    Attributes:
        record: row of the table of attempts, with the outcome "lost".
        status: step, speed and recent return of the run.
        parts: result files of the newest checkpoint; None before the first.
        node: id of the attempt's node, empty without a cluster.
    """

    record: AttemptRecord
    status: Status
    parts: tuple[PartFile, ...] | None
    node: str = ""


class Attempt:
    """Attempt at a run in this process, from the newest checkpoint or, if there is none, from the start.

    `execute` fetches input files, resumes, trains, commits at checkpoints and finishes, with a log in the
    results root. Other threads may call the other methods.

    Args:
        spec: run to execute.
        store: results root.
        number: number of this attempt, unique to this process.
        placement: device, threads, time between checkpoints.
        teacher: factory of the link to the teacher.
    """

    def __init__(
        self,
        spec: RunSpec,
        store: Store,
        number: int,
        placement: Placement | None = None,
        teacher: Callable[[RunSpec], TeacherLink] = InlineTeacher,
    ) -> None:
        self.spec = spec
        self._store = store
        self._number = number
        self._placement = placement or Placement()
        self._teacher = teacher
        self._started_at, self._created = datetime.now(UTC), time.monotonic()
        self._checkpoints = Checkpoints(store, spec.run_id, number)
        self._episodic_returns: list[float] = []
        self._parts: tuple[PartFile, ...] | None = None
        self._run: Run | None = None

    def execute(
        self, should_stop: Callable[[], bool], publish: Callable[[Sequence[PartFile]], None] = lambda _: None
    ) -> tuple[PartFile, ...] | None:
        """Resume the run, and train until the budget is spent or a stop is requested.

        Args:
            should_stop: function called after every episode, which returns True to stop.
            publish: function called with the run's parts after every checkpoint.

        Returns:
            The canonical result files, or None after a stop, which leaves a checkpoint.

        Raises:
            StaleAttemptError: if a later attempt was accepted, since this one was taken for lost.
            StorageError: if the results root refuses a write.
            LearnerLostError: if the learner of the run's cohort is lost.
        """
        with RunLog(self._store, self.spec.run_id, self._number) as log:
            run = self._prepare()
            while True:
                episode = run.advance()
                if episode is not None:
                    self._episodic_returns = [
                        *self._episodic_returns[1 - RECENT_EPISODES :],
                        episode.episodic_return,
                    ]
                if run.finished:
                    break
                stopping = should_stop()
                evaluated = run.progress.evaluations > self._saved_evaluations
                waited = time.monotonic() - self._saved_at
                if stopping or evaluated or waited > self._placement.checkpoint_seconds:
                    publish(self._checkpoint(run, should_stop))
                    log.publish()
                if stopping:
                    logger.info("stopped as asked at step %s", f"{run.progress.step:,}")
                    return None
            final = retry(lambda: self._finish(run), self._placement.outage_seconds, should_stop)
            logger.info("done")
            return final

    def status(self) -> Status:
        """Return the run's step, speed and recent return; only valid during training."""
        assert self._run is not None, "an attempt that trains has a run"
        step, seconds = self._run.progress.step, time.monotonic() - self._started
        recent = float(np.mean(self._episodic_returns)) if self._episodic_returns else float("nan")
        return Status(step, (step - self._first_step) / max(seconds, 1e-9), recent)

    def report(self) -> Report | None:
        """Return the progress, or None during setup."""
        if self._run is None:
            return None
        return Report(self.record(AttemptOutcome.LOST), self.status(), self._parts)

    def record(self, outcome: AttemptOutcome) -> AttemptRecord:
        """Return the current row of this attempt in the table of attempts, with the given outcome."""
        return AttemptRecord(
            run_id=self.spec.run_id,
            attempt=self._number,
            started_at=self._started_at,
            wall_seconds=time.monotonic() - self._created,
            env_steps_per_second=self.status().steps_per_second,
            host=platform.node(),
            fingerprint=self.fingerprint,
            outcome=outcome,
        )

    def close(self) -> None:
        """Close the run's environments."""
        if self._run is not None:
            self._run.close()

    def _prepare(self) -> Run:
        """Construct the run, and restore its newest checkpoint if there is one."""
        placement = self._placement
        learner, device = placement.learner, placement.device
        described = ask_learner(learner, "hardware") if learner else gpu(device)
        self.fingerprint = fingerprint(placement.threads, device, described)
        fetch(self._store, self.spec)
        writer = RunWriter(self._store, self.spec.run_id, self._number)
        run = Run(self.spec, self._teacher(self.spec), writer, placement)
        checkpoint = retry(lambda: self._checkpoints.restore(run), placement.outage_seconds)
        if checkpoint is not None:
            run.writer = RunWriter(self._store, self.spec.run_id, self._number, checkpoint.parts)
            if checkpoint.fingerprint != self.fingerprint:
                logger.warning(
                    "run %s resumes on another machine or with other libraries: its results will be sound, "
                    "but not bit-identical to an uninterrupted run",
                    self.spec.run_id,
                )
        self._started, self._first_step = time.monotonic(), run.progress.step
        self._saved_at, self._saved_evaluations = self._started, run.progress.evaluations
        self._run = run
        logger.info(
            "attempt %d on %s, %s, %d threads: from step %s of %s",
            self._number,
            platform.node(),
            device,
            placement.threads,
            f"{self._first_step:,}",
            f"{self.spec.schedule.steps:,}",
        )
        self._keep_record()
        return run

    def _checkpoint(self, run: Run, should_stop: Callable[[], bool]) -> tuple[PartFile, ...]:
        """Write the new rows and a checkpoint, and return all parts so far."""

        def write() -> tuple[tuple[PartFile, ...], int]:
            accepted_manifest(self._store, self.spec.run_id, self._number)
            parts = run.writer.flush()
            return parts, self._checkpoints.save(run, parts, self.fingerprint)

        started = time.monotonic()
        self._parts, size = retry(write, self._placement.outage_seconds, should_stop)
        self._saved_at, self._saved_evaluations = time.monotonic(), run.progress.evaluations
        status = self.status()
        logger.info(
            "step %s: %.0f steps/s, episodic return %.1f; checkpoint of %.1f MB in %.1f s",
            f"{status.step:,}",
            status.steps_per_second,
            status.episodic_return,
            size / 1e6,
            self._saved_at - started,
        )
        self._keep_record()
        return self._parts

    def _keep_record(self) -> None:
        with suppress(StorageError):  # not worth failing the run, since the next record replaces this one
            write_progress(self._store, self.record(AttemptOutcome.LOST))

    def _finish(self, run: Run) -> tuple[PartFile, ...]:
        """Write the final policy with its spec and the canonical result files, and return these files."""
        folder = staged_policy(self.spec.run_id, self._number)
        with tempfile.TemporaryDirectory() as temporary:
            run.student.save_policy(Path(temporary))
            for path in sorted(Path(temporary).iterdir()):
                self._store.write_bytes(f"{folder}/{path.name}", path.read_bytes())
        self._store.write_bytes(f"{folder}/spec.json", json.dumps(self.spec.to_dict(), indent=1).encode())
        return run.writer.finish()


LOGGER = "tma_ray"
"""Name of the logger whose messages, and those of its children, are in the log."""


class RunLog(logging.Handler):
    """Context manager that writes this process's log messages of level INFO and above to the results root.

    Each publication rewrites the file, since object stores cannot append. An exception in the context becomes
    the last message. Messages since the last publication are lost if the process is killed.
    """

    def __init__(self, store: Store, run_id: str, attempt: int) -> None:
        super().__init__(logging.INFO)
        formatter = logging.Formatter("%(asctime)s %(levelname)s %(message)s", "%Y-%m-%d %H:%M:%S")
        formatter.converter = time.gmtime
        self.setFormatter(formatter)
        self._store, self._path = store, log_path(run_id, attempt)
        self._lines: list[str] = []
        self._published = 0

    def __enter__(self) -> Self:
        logger = logging.getLogger(LOGGER)
        self._level_before = logger.level
        logger.setLevel(min(logger.getEffectiveLevel(), logging.INFO))
        logger.addHandler(self)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        logger = logging.getLogger(LOGGER)
        if error is not None:
            self._lines += "".join(traceback.format_exception(error)).rstrip().splitlines()
        logger.removeHandler(self)
        logger.setLevel(self._level_before)
        self.publish()

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a message until it is published."""
        self._lines.append(self.format(record))

    def publish(self) -> None:
        """Publish all messages so far if there are new ones."""
        count = len(self._lines)
        if count > self._published:
            with suppress(StorageError):  # not worth failing the run, since the next call has all messages
                self._store.write_bytes(self._path, ("\n".join(self._lines) + "\n").encode())
                self._published = count


def run_locally(
    spec: RunSpec,
    committer: Committer,
    placement: Placement | None = None,
    should_stop: Callable[[], bool] = lambda: False,
    on_status: Callable[[Status], None] = lambda _: None,
) -> AttemptOutcome:
    """Execute a run in this process, from its newest checkpoint if any, and return the outcome.

    Args:
        spec: run to execute, unless the root has its results.
        committer: committer of the results root.
        placement: device, threads, time between checkpoints.
        should_stop: function called after every episode; a stopped run leaves a checkpoint.
        on_status: function called with the run's status after every episode.

    Returns:
        The outcome of the attempt.

    Raises:
        StorageError: if the root refuses writes for too long; the run can be resumed.
        LearnerLostError: if the learner of its cohort is lost; the run can be resumed.
        Exception: if a component raises it; the run is marked as failed.
    """
    check_type("spec", spec, RunSpec, "a RunSpec, as of effective_spec")
    check_type("committer", committer, Committer, "a Committer, as Committer.open('results')")
    if committer.done([spec.run_id]):
        return AttemptOutcome.DONE
    placement, record = placement or Placement(), spec.record()
    RunInputs.of([spec]).keep(committer.store)
    number = committer.start(record)
    attempt = Attempt(spec, committer.store, number, placement)

    def show_and_ask() -> bool:
        on_status(attempt.status())
        return should_stop()

    def publish(parts: Sequence[PartFile]) -> None:
        retry(lambda: committer.publish(record, number, parts), placement.outage_seconds, should_stop)

    outcome = AttemptOutcome.FAILED
    try:
        final = attempt.execute(show_and_ask, publish)
        outcome = AttemptOutcome.STOPPED if final is None else AttemptOutcome.DONE
        if final is not None:
            retry(lambda: committer.finish(record, number, final), placement.outage_seconds, should_stop)
            Checkpoints(committer.store, spec.run_id, number).drop()
    except (StorageError, LearnerLostError):
        outcome = AttemptOutcome.LOST
        raise
    except Exception:
        committer.fail(record, number, traceback.format_exc())
        raise
    finally:
        if attempt.report() is not None:
            committer.record_attempt(attempt.record(outcome))
            attempt.close()
    return outcome
