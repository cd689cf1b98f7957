"""One attempt at a run: resume, train, commit at checkpoints, finish; its log; runs in this process."""

from __future__ import annotations

import json
import logging
import platform
import tempfile
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from tma_ray.arguments import check_kind
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
from tma_ray.runs.inputs import fetch, keep
from tma_ray.runs.placement import Placement, Status, fingerprint, gpu
from tma_ray.runs.run import Run
from tma_ray.runs.spec import RunSpec
from tma_ray.runs.teaching import InlineTeacher, TeacherLink
from tma_ray.students.players import LearnerLostError, hardware

RECENT_EPISODES = 100

logger = logging.getLogger(__name__)


class Attempt:
    """Executes a run from its newest checkpoint, or from the start.

    Args:
        spec: what to run.
        store: the results root.
        number: of this attempt; no two processes may share one.
        teacher: the link to the teacher of `spec`.
        placement: device, threads, time between checkpoints.
    """

    def __init__(
        self,
        spec: RunSpec,
        store: Store,
        number: int,
        teacher: TeacherLink,
        placement: Placement | None = None,
    ) -> None:
        self._started_at, self._created = datetime.now(UTC), time.monotonic()
        self.spec = spec
        self._store = store
        self._number = number
        self._placement = placement or Placement()
        learner, device = self._placement.learner, self._placement.device
        described = hardware(learner) if learner else gpu(device)
        self.fingerprint = fingerprint(self._placement.threads, device, described)
        self._checkpoints = Checkpoints(store, spec.run_id, number)
        fetch(store, spec)
        writer = RunWriter(store, spec.run_id, number)
        self._run = Run(spec, teacher, writer, self._placement)
        self._resume()
        self._started, self._first_step = time.monotonic(), self._run.progress.step
        self._saved_at, self._saved_evaluations = self._started, self._run.progress.evaluations
        self._episodic_returns: list[float] = []
        logger.info(
            "attempt %d on %s, %s, %d threads: from step %s of %s",
            number,
            platform.node(),
            self._placement.device,
            self._placement.threads,
            f"{self._first_step:,}",
            f"{spec.schedule.steps:,}",
        )
        self._keep_record()

    def execute(
        self, should_stop: Callable[[], bool], publish: Callable[[Sequence[PartFile]], None]
    ) -> tuple[PartFile, ...] | None:
        """Trains until the budget is spent or a stop is asked for.

        Args:
            should_stop: asked after every episode.
            publish: told the parts of the run after every checkpoint.

        Returns:
            The canonical result files, or None after a stop, which leaves a checkpoint.

        Raises:
            StaleAttemptError: at a checkpoint, if a later attempt is accepted: this one was taken for lost.
            StorageError: the results root does not take what is written.
        """
        run = self._run
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
            if stopping or self._checkpoint_due():
                self._checkpoint(should_stop, publish)
            if stopping:
                logger.info("stopped as asked at step %s", f"{run.progress.step:,}")
                return None
        final = retry(self._finish, self._placement.outage_seconds, should_stop)
        logger.info("done")
        return final

    def status(self) -> Status:
        """Returns where the run stands; safe to call from another thread."""
        step, seconds = self._run.progress.step, time.monotonic() - self._started
        recent = float(np.mean(self._episodic_returns)) if self._episodic_returns else float("nan")
        return Status(step, (step - self._first_step) / max(seconds, 1e-9), recent)

    def record(self, outcome: AttemptOutcome) -> AttemptRecord:
        """Returns the row of the table of attempts, as if the attempt ended now with `outcome`."""
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
        """Closes the run's environments."""
        self._run.close()

    def _resume(self) -> None:
        checkpoint = retry(lambda: self._checkpoints.restore(self._run), self._placement.outage_seconds)
        if checkpoint is None:
            return
        self._run.writer = RunWriter(self._store, self.spec.run_id, self._number, checkpoint.parts)
        if checkpoint.fingerprint != self.fingerprint:
            logger.warning(
                "run %s resumes on another machine or with other libraries: its results will be sound, "
                "but not bit-identical to an uninterrupted run",
                self.spec.run_id,
            )

    def _checkpoint_due(self) -> bool:
        evaluated = self._run.progress.evaluations > self._saved_evaluations
        return evaluated or time.monotonic() - self._saved_at > self._placement.checkpoint_seconds

    def _checkpoint(
        self, should_stop: Callable[[], bool], publish: Callable[[Sequence[PartFile]], None]
    ) -> None:
        started = time.monotonic()
        parts, size = retry(self._write_checkpoint, self._placement.outage_seconds, should_stop)
        self._saved_at, self._saved_evaluations = time.monotonic(), self._run.progress.evaluations
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
        publish(parts)

    def _keep_record(self) -> None:
        with suppress(StorageError):  # no run fails for its row; the next record holds more
            write_progress(self._store, self.record(AttemptOutcome.LOST))

    def _write_checkpoint(self) -> tuple[tuple[PartFile, ...], int]:
        """Writes rows and state; returns the parts of the run so far, and the bytes of state written."""
        accepted_manifest(self._store, self.spec.run_id, self._number)
        parts = self._run.writer.flush()
        return parts, self._checkpoints.save(self._run, parts, self.fingerprint)

    def _finish(self) -> tuple[PartFile, ...]:
        """Writes the final policy and the canonical result files, which it returns."""
        self._save_policy()
        return self._run.writer.finish()

    def _save_policy(self) -> None:
        folder = staged_policy(self.spec.run_id, self._number)
        with tempfile.TemporaryDirectory() as place:
            self._run.student.save_policy(Path(place))
            for path in sorted(Path(place).iterdir()):
                self._store.write_bytes(f"{folder}/{path.name}", path.read_bytes())
        self._store.write_bytes(f"{folder}/spec.json", json.dumps(self.spec.to_dict(), indent=1).encode())


LOGGER = "tma_ray"
"""Whose messages, and those below it, are kept: plug-ins may log to ``tma_ray.plugins.…``."""


class RunLog(logging.Handler):
    """Context that keeps this process's messages from INFO on, and publishes them when asked and at its end.

    The file is written whole each time, since object stores cannot append. An exception that leaves the
    context is its last message. Of a process that is killed, what came after the last publication is lost.

    Args:
        store: the results root.
        run_id: of the run.
        attempt: its number.
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
        """Keeps a message."""
        self._lines.append(self.format(record))

    def publish(self) -> None:
        """Writes all messages so far, if there are new ones."""
        count = len(self._lines)
        if count > self._published:
            with suppress(StorageError):  # no run fails for its log; the next publication holds all
                self._store.write_bytes(self._path, ("\n".join(self._lines) + "\n").encode())
                self._published = count


def run_locally(
    spec: RunSpec,
    committer: Committer,
    placement: Placement | None = None,
    should_stop: Callable[[], bool] = lambda: False,
    on_status: Callable[[Status], None] = lambda _: None,
) -> AttemptOutcome:
    """Runs `spec` in this process, from its newest checkpoint if there is one.

    Args:
        spec: what to run; nothing happens if the root holds its results already.
        committer: of the results root.
        placement: device, threads, time between checkpoints.
        should_stop: asked after every episode; a stopped run leaves a checkpoint.
        on_status: told the run's status after every episode.

    Returns:
        How the attempt ended.

    Raises:
        StorageError: the root refused to take what was written for long; the run can be taken up again.
        LearnerLostError: the learner of its cohort is gone; likewise.
        Exception: whatever the run's parts raise, after the run is marked as failed.
    """
    check_kind("spec", spec, RunSpec, "a RunSpec, as of effective_spec")
    check_kind("committer", committer, Committer, "a Committer, as Committer.open('results')")
    if committer.done([spec.run_id]):
        return AttemptOutcome.DONE
    return _attempt(spec, committer, placement or Placement(), should_stop, on_status)


def _attempt(
    spec: RunSpec,
    committer: Committer,
    placement: Placement,
    should_stop: Callable[[], bool],
    on_status: Callable[[Status], None],
) -> AttemptOutcome:
    record = spec.record()
    keep(committer.store, [spec])
    fetch(committer.store, spec)
    number = committer.start(record)
    attempt, outcome = None, AttemptOutcome.FAILED
    try:
        with RunLog(committer.store, spec.run_id, number) as log:

            def publish(parts: Sequence[PartFile]) -> None:
                retry(lambda: committer.publish(record, number, parts), placement.outage_seconds, should_stop)
                log.publish()

            attempt = Attempt(spec, committer.store, number, InlineTeacher(spec), placement)
            final = attempt.execute(_reporting(attempt, should_stop, on_status), publish)
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
        if attempt is not None:
            committer.record_attempt(attempt.record(outcome))
            attempt.close()
    return outcome


def _reporting(
    attempt: Attempt, should_stop: Callable[[], bool], on_status: Callable[[Status], None]
) -> Callable[[], bool]:
    def asked() -> bool:
        on_status(attempt.status())
        return should_stop()

    return asked
