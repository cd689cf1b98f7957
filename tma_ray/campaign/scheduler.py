"""The central scheduler: feeds runs to the cluster, publishes what they commit, replaces what dies."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

import ray
from ray.exceptions import ActorUnavailableError, RayActorError, RayTaskError

from tma_ray.campaign.cluster.base import Head
from tma_ray.campaign.executors.actors import (
    LOSSES,
    Report,
    SeedActor,
    node_strategy,
    plain_traceback,
    reason_for_loss,
)
from tma_ray.campaign.executors.cohorts import AnyNode, Cohorts, Kind, Place, Places
from tma_ray.campaign.failures import HeadLostError, Retries, RetryingCommitter, Silence
from tma_ray.campaign.progress import ActiveRun, Snapshot, View
from tma_ray.campaign.settings import Settings
from tma_ray.results import (
    AttemptOutcome,
    AttemptRecord,
    Committer,
    LearnerProgress,
    PartFile,
)
from tma_ray.runs.checkpoints import Checkpoints
from tma_ray.runs.spec import RunSpec

UNREACHABLE_PAUSE = 0.5
"""Before an actor is called again that did not answer, and for which a first report is waited for, s."""

logger = logging.getLogger(__name__)


@dataclass
class _Running:
    """A run that has an actor."""

    spec: RunSpec
    actor: Any
    result: Any
    number: int
    submitted_at: datetime
    asked: Any = None
    report: Report | None = None


class Scheduler:
    """Executes runs on the connected Ray cluster, alone or in cohorts, with as many in flight as it holds.

    Every run gets a fresh actor. A run whose process dies is taken up again from its newest checkpoint by a
    new attempt; a run that raises is marked as failed, with its traceback, and the others go on.

    Args:
        committer: of the results root.
        settings: resources and placement of every run.
        view: shows the progress.
        keep_lease: called before anything is published; raises if another campaign holds the root.
        head: of the Ray that this process is connected to.
        kinds: of the runs by their ids, see `kinds_of`, if they learn in cohorts.
    """

    def __init__(
        self,
        committer: Committer,
        settings: Settings,
        view: View,
        keep_lease: Callable[[], None],
        head: Head,
        kinds: Mapping[str, Kind] | None = None,
    ) -> None:
        self._committer = RetryingCommitter(committer, keep_lease, settings.outage_seconds)
        self._settings, self._kinds = settings, kinds or {}
        self._view, self._head = view, head
        self._waiting: deque[RunSpec] = deque()
        self._running: dict[Any, _Running] = {}
        self._retries = Retries(settings.most_losses)
        self._silence = Silence(settings.unreachable_seconds)
        self._places: Places
        self._learners: Sequence[LearnerProgress] = ()
        self._done = self._failed = self._stopped = 0

    def execute(self, specs: Sequence[RunSpec], stop_requested: Callable[[], bool]) -> Snapshot:
        """Runs all of `specs` whose results the root does not hold yet.

        Args:
            specs: the runs.
            stop_requested: once true, runs leave with a checkpoint and nothing new starts.

        Returns:
            How many ended how.

        Raises:
            HeadLostError: Ray is gone; its runs are recorded as lost.
        """
        done = self._committer.call(Committer.done, [spec.run_id for spec in specs])
        self._done = len(done)
        self._waiting.extend(spec for spec in specs if spec.run_id not in done)
        where = self._settings, self._head
        self._places = Cohorts(*where, specs, self._kinds) if self._settings.width else AnyNode(*where)
        self._total, self._total_steps = len(specs), sum(spec.schedule.steps for spec in specs)
        try:
            while self._waiting or self._running or self._retries:
                if stop_requested():
                    self._stop_all()
                    break
                self._fill()
                self._wait(self._settings.poll_seconds)
        except HeadLostError:  # no call of Ray may follow: it would start another one
            self._record_lost()
            self._running.clear()
            self._places = AnyNode(self._settings, self._head)
            raise
        finally:
            # Also on a second Ctrl-C or an error of ours: no actor outlives its campaign.
            for running in self._running.values():
                ray.kill(running.actor)
            self._places.close()
            self._view.close(self._snapshot())
        return self._snapshot()

    def abandon(self) -> None:
        """Records all runs as lost and ends the view: for a thread beside one that waits for Ray."""
        self._record_lost()
        self._view.close(self._snapshot())

    def _fill(self) -> None:
        self._waiting.extend(self._retries.due())
        while (found := self._places.take(self._waiting)) is not None:
            self._start(*found)

    def _start(self, spec: RunSpec, place: Place) -> None:
        number = self._committer.call(Committer.start, spec.record())
        actor = SeedActor.launch(
            self._settings.each,
            node_strategy(place.node, self._retries.nodes_to_avoid(spec.run_id)),
            spec.to_dict(),
            self._committer.store,
            number,
            place.placement,
            self._settings.teachers,
        )
        result = actor.run.remote()
        self._running[result] = _Running(spec, actor, result, number, datetime.now(UTC))

    def _wait(self, seconds: float) -> None:
        ended: list[Any] = []
        if self._running:
            ended, _ = ray.wait(list(self._running), num_returns=1, timeout=seconds)
        else:  # all that is left pauses after a loss
            time.sleep(seconds)
        self._committer.keep_lease()
        self._head.check()  # before anything is made of what has ended with it
        self._learners = self._places.look(over=not (self._waiting or self._retries))
        for result in ended:
            self._handle_exit(self._running.pop(result))
        for running in self._running.values():
            self._poll_report(running)
        self._view.update(self._snapshot())

    def _poll_report(self, running: _Running) -> None:
        """Takes in the report that was asked for, if it has come, and asks for the next."""
        if running.asked is not None:
            if not ray.wait([running.asked], timeout=0)[0]:
                return
            asked, running.asked = running.asked, None
            try:
                self._receive_report(running, ray.get(asked))
            except RayActorError:
                return  # its result says the same and is dealt with there
        running.asked = running.actor.report.remote()

    def _receive_report(self, running: _Running, report: Report | None) -> None:
        self._silence.end(running.spec.run_id)
        news = report is not None and (running.report is None or report.parts != running.report.parts)
        running.report = report or running.report
        if report is not None and report.parts is not None and news:
            self._committer.call(Committer.publish, running.spec.record(), running.number, report.parts)

    def _handle_exit(self, running: _Running) -> None:
        """Deals with a run whose actor has returned, raised or died."""
        try:
            final: tuple[PartFile, ...] | None = ray.get(running.result)
        except ActorUnavailableError as error:
            if self._reconnect(running):
                return
            self._handle_loss(running, error)
        except LOSSES as error:
            self._handle_loss(running, error)
        except RayTaskError as error:
            self._record(running, AttemptOutcome.FAILED)
            traceback = plain_traceback(error)
            self._committer.call(Committer.fail, running.spec.record(), running.number, traceback)
            self._failed += 1
        else:
            self._fetch_final_report(running)
            if final is None:
                self._record(running, AttemptOutcome.STOPPED)
                self._stopped += 1
            else:
                self._committer.call(Committer.finish, running.spec.record(), running.number, final)
                Checkpoints(self._committer.store, running.spec.run_id, running.number).drop()
                self._record(running, AttemptOutcome.DONE)
                self._done += 1
        self._places.leave(running.spec.run_id)
        ray.kill(running.actor)

    def _reconnect(self, running: _Running) -> bool:
        """Waits for a run again that does not answer and may live; returns False when that took too long."""
        if self._silence.lasts(running.spec.run_id):
            return False
        time.sleep(UNREACHABLE_PAUSE)
        running.result, running.asked = running.actor.run.remote(), None
        self._running[running.result] = running
        return True

    def _handle_loss(self, running: _Running, error: Exception) -> None:
        self._silence.end(running.spec.run_id)
        self._record(running, AttemptOutcome.LOST)
        run_id, node = running.spec.run_id, running.report.node if running.report else ""
        reason = reason_for_loss(error)
        if self._places.excuses(run_id):
            self._waiting.append(running.spec)
        elif self._retries.add_loss(running.spec, node):
            logger.warning("run %s was lost and resumes from its checkpoint: %s", run_id, reason)
        else:
            message = f"it was lost {self._retries.losses(run_id)} times, last: {reason}"
            self._committer.call(Committer.fail, running.spec.record(), running.number, message)
            self._failed += 1

    def _stop_all(self) -> None:
        """Asks all runs for a checkpoint and waits for them, for the grace period at most."""
        self._hear_the_unheard()
        for result, running in list(self._running.items()):
            if running.report is None:  # it has not begun to train: there is nothing to save or to record
                self._committer.call(Committer.withdraw, running.spec.run_id, running.number)
                self._waiting.append(self._running.pop(result).spec)
                self._places.leave(running.spec.run_id)
                ray.kill(running.actor)
            else:
                running.actor.request_stop.remote()
        deadline = time.monotonic() + self._settings.grace_seconds
        while self._running and time.monotonic() < deadline:
            self._wait(0.2)
        self._record_lost()

    def _hear_the_unheard(self) -> None:
        """Takes in first reports that are on their way: a run may train since the last look."""
        unheard = [running for running in self._running.values() if running.report is None]
        asked = [running.asked for running in unheard if running.asked is not None]
        if asked:
            ray.wait(asked, num_returns=len(asked), timeout=UNREACHABLE_PAUSE)
        for running in unheard:
            self._poll_report(running)

    def _fetch_final_report(self, running: _Running) -> None:
        try:
            self._receive_report(running, ray.get(running.actor.report.remote(), timeout=10))
        except (RayActorError, ray.exceptions.GetTimeoutError):
            return  # what it reported before stands

    def _record_lost(self) -> None:
        for running in list(self._running.values()):
            self._record(running, AttemptOutcome.LOST)

    def _record(self, running: _Running, outcome: AttemptOutcome) -> None:
        unheard = AttemptRecord(
            running.spec.run_id, running.number, running.submitted_at, 0.0, 0.0, "", "{}", outcome
        )
        record = running.report.record if running.report else unheard
        self._committer.call(Committer.record_attempt, replace(record, outcome=outcome))

    def _snapshot(self) -> Snapshot:
        starting = [r.spec for r in self._running.values() if r.report is None]
        waiting = [*self._waiting, *self._retries.specs, *starting]
        active = [
            ActiveRun(r.spec.run_id, r.spec.schedule.steps, r.report.status)
            for r in self._running.values()
            if r.report is not None
        ]
        return Snapshot(
            total=self._total,
            done=self._done,
            failed=self._failed,
            stopped=self._stopped,
            waiting=len(waiting),
            waiting_steps=sum(spec.schedule.steps for spec in waiting),
            total_steps=self._total_steps,
            running=active,
            learners=self._learners,
        )
