"""Scheduling of runs: starts, commits of results, and retries after losses."""

import logging
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

from tma_ray.campaign.executors.base import AttemptEnd, Executor
from tma_ray.campaign.failures import HeadLostError, Retries, RetryingCommitter
from tma_ray.campaign.progress import ActiveRun, ProgressDisplay, Snapshot
from tma_ray.campaign.settings import ExecutionConfig
from tma_ray.results import AttemptOutcome, AttemptRecord, Committer
from tma_ray.runs.attempt import Report
from tma_ray.runs.checkpoints import Checkpoints
from tma_ray.runs.spec import RunSpec

STOPPING_POLL_SECONDS = 0.2  # interval between polls while runs write their last checkpoints, s

logger = logging.getLogger(__name__)


@dataclass
class _Running:
    """Run under way, with its current attempt and latest report."""

    spec: RunSpec
    number: int
    started_at: datetime
    report: Report | None = None


class Scheduler:
    """Scheduler that starts runs on an executor, commits their results and retries lost runs.

    A new attempt resumes a lost run from its newest checkpoint. A run that raises is marked as failed, with
    its traceback. `keep_lease` is called before every commit, and raises if another campaign holds the root.
    """

    def __init__(
        self,
        committer: Committer,
        executor: Executor,
        settings: ExecutionConfig,
        view: ProgressDisplay,
        keep_lease: Callable[[], None] = lambda: None,
    ) -> None:
        self._store = committer.store
        self._committer = RetryingCommitter(committer, keep_lease, settings.outage_seconds)
        self._executor, self._settings, self._view = executor, settings, view
        self._waiting: deque[RunSpec] = deque()
        self._running: dict[str, _Running] = {}
        self._retries = Retries(settings.most_losses)
        self._done = self._failed = self._stopped = 0

    def execute(self, specs: Sequence[RunSpec], stop_requested: Callable[[], bool]) -> Snapshot:
        """Execute the runs of `specs` that are not done, in order, and return the final progress.

        The root must have their inputs already (`RunInputs.keep`). Once `stop_requested` returns True, runs
        stop with a checkpoint and nothing new starts.

        Raises:
            HeadLostError: if Ray is lost; running attempts are recorded as lost.
        """
        done = self._committer.call(Committer.done, [spec.run_id for spec in specs])
        self._done = len(done)
        self._waiting.extend(spec for spec in specs if spec.run_id not in done)
        self._total, self._total_steps = len(specs), sum(spec.schedule.steps for spec in specs)
        try:
            while self._waiting or self._running or self._retries:
                if stop_requested():
                    self._stop()
                    break
                self._fill()
                self._poll(self._settings.poll_seconds)
        except HeadLostError:
            self._record_lost()
            self._running.clear()
            raise
        finally:  # no attempt outlives its campaign, even after an error
            self._executor.close()
            self._view.close(self._snapshot())
        return self._snapshot()

    def record_loss(self) -> None:
        """Record running attempts as lost and close the display, while another thread is blocked in Ray."""
        self._record_lost()
        self._view.close(self._snapshot())

    def _fill(self) -> None:
        """Start as many attempts as the executor accepts."""
        self._waiting.extend(self._retries.due())
        while (spec := self._executor.take(self._waiting)) is not None:
            number = self._committer.call(Committer.start, spec.record())
            self._executor.start(spec, number, self._retries.nodes_to_avoid(spec.run_id))
            self._running[spec.run_id] = _Running(spec, number, datetime.now(UTC))

    def _poll(self, seconds: float) -> None:
        """Commit what the executor reports within `seconds`, and show the progress."""
        events = self._executor.poll(seconds, last=not (self._waiting or self._retries))
        self._committer.keep_lease()
        for event in events:
            if isinstance(event, Report):
                running = self._running[event.record.run_id]
                before, running.report = running.report, event
                if event.parts is not None and (before is None or event.parts != before.parts):
                    record = running.spec.record()
                    self._committer.call(Committer.publish, record, running.number, event.parts)
            else:
                self._conclude(self._running.pop(event.run_id), event)
        self._view.update(self._snapshot())

    def _conclude(self, running: _Running, ending: AttemptEnd) -> None:
        """Commit the outcome of an attempt that has ended."""
        record, number = running.spec.record(), running.number
        if ending.outcome is AttemptOutcome.DONE:
            self._committer.call(Committer.finish, record, number, ending.files)
            Checkpoints(self._store, record.run_id, number).drop()
            self._done += 1
        if ending.without_fault and running.report is None:  # the attempt had not begun to train
            self._committer.call(Committer.withdraw, record.run_id, number)
        else:
            self._record(running, ending.outcome)
        if ending.outcome is AttemptOutcome.STOPPED:
            self._stopped += 1
        elif ending.outcome is AttemptOutcome.FAILED:
            self._fail(running, ending.reason)
        elif ending.outcome is AttemptOutcome.LOST:
            self._repeat(running, ending)

    def _fail(self, running: _Running, reason: str) -> None:
        self._committer.call(Committer.fail, running.spec.record(), running.number, reason)
        self._failed += 1

    def _repeat(self, running: _Running, loss: AttemptEnd) -> None:
        """Retry a lost run, or mark it as failed after too many losses."""
        node = running.report.node if running.report else ""
        if loss.without_fault:
            self._waiting.append(running.spec)
        elif self._retries.add_loss(running.spec, node):
            logger.warning("run %s was lost and resumes from its checkpoint: %s", loss.run_id, loss.reason)
        else:
            self._fail(running, f"it was lost {self._retries.losses(loss.run_id)} times, last: {loss.reason}")

    def _stop(self) -> None:
        """Stop all runs after a last checkpoint, waiting for at most the grace period."""
        self._executor.stop()
        deadline = time.monotonic() + self._settings.grace_seconds
        while self._running and time.monotonic() < deadline:
            self._poll(STOPPING_POLL_SECONDS)
        self._record_lost()

    def _record_lost(self) -> None:
        for running in list(self._running.values()):
            self._record(running, AttemptOutcome.LOST)

    def _record(self, running: _Running, outcome: AttemptOutcome) -> None:
        """Write the row of an attempt; before the first report, it has only a start time."""
        if running.report is None:
            run_id, started_at = running.spec.run_id, running.started_at
            record = AttemptRecord(run_id, running.number, started_at, 0.0, 0.0, "", "{}", outcome)
        else:
            record = replace(running.report.record, outcome=outcome)
        self._committer.call(Committer.record_attempt, record)

    def _snapshot(self) -> Snapshot:
        attempts = list(self._running.values())
        starting = [attempt.spec for attempt in attempts if attempt.report is None]
        waiting = [*self._waiting, *self._retries.specs, *starting]
        return Snapshot(
            total=self._total,
            done=self._done,
            failed=self._failed,
            stopped=self._stopped,
            waiting=len(waiting),
            waiting_steps=sum(spec.schedule.steps for spec in waiting),
            total_steps=self._total_steps,
            running=[
                ActiveRun(attempt.spec.run_id, attempt.spec.schedule.steps, attempt.report.status)
                for attempt in attempts
                if attempt.report is not None
            ],
            learners=self._executor.learners,
        )
