"""One attempt at a run: resume, train, commit at checkpoints, finish."""

from __future__ import annotations

import json
import logging
import platform
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from tma_ray.results import (
    AttemptOutcome,
    AttemptRecord,
    PartFile,
    RunWriter,
    StorageError,
    Store,
    accepted_manifest,
    retry,
    staged_policy,
    write_progress,
)
from tma_ray.runs.checkpoints import Checkpoints
from tma_ray.runs.inputs import fetch
from tma_ray.runs.placement import Placement, Status, fingerprint, gpu
from tma_ray.runs.run import Run
from tma_ray.runs.spec import RunSpec
from tma_ray.runs.teaching import TeacherLink
from tma_ray.students.players import hardware

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
