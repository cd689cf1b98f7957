"""Executor of attempts in Ray actors, on this machine or a cluster."""

import time
from collections import deque
from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import ray
from ray.exceptions import (
    ActorUnavailableError,
    ActorUnschedulableError,
    GetTimeoutError,
    RayActorError,
    RayTaskError,
)

from tma_ray.campaign.cluster.nodes import capacity
from tma_ray.campaign.cluster.protocols import Head
from tma_ray.campaign.executors.actors import SeedActor, node_strategy, reason_for_loss
from tma_ray.campaign.executors.base import LOSSES, AttemptEnd
from tma_ray.campaign.executors.cohorts import Cohorts
from tma_ray.campaign.failures import HeadLostError, SilentRuns
from tma_ray.campaign.settings import ExecutionConfig
from tma_ray.results import AttemptOutcome, LearnerProgress, Store
from tma_ray.runs.attempt import Report
from tma_ray.runs.spec import RunSpec
from tma_ray.support.texts import visible

UNREACHABLE_PAUSE = 0.5
"""Pause before calling an unavailable actor again, and longest wait for first reports, s."""

FINAL_REPORT_SECONDS = 10.0  # longest wait for the last report of a run, s


@dataclass
class _Running:
    """Running attempt, with its actor and pending calls."""

    run_id: str
    actor: Any
    result: Any
    report: Any = None
    has_reported: bool = False


class RayExecutor:
    """Executor that creates a new Ray actor for each attempt; see `Executor`.

    Without cohorts, it submits more runs than the nodes hold, as demand for an autoscaler.
    """

    def __init__(
        self, store: Store, settings: ExecutionConfig, head: Head, cohorts: Cohorts | None = None
    ) -> None:
        self._store, self._settings, self._head, self._cohorts = store, settings, head, cohorts
        self._silent = SilentRuns(settings.unreachable_seconds)
        self._taken: set[str] = set()
        self._running: dict[Any, _Running] = {}
        self._pending: list[Report | AttemptEnd] = []
        self._connected = True
        self.learners: Sequence[LearnerProgress] = ()

    def take(self, waiting: deque[RunSpec]) -> RunSpec | None:
        """Remove and return a run that can start now; see `Executor`."""
        if self._cohorts is not None:
            return self._cohorts.take(waiting)
        room = capacity(self._settings.resources, self._head.nodes()) + self._settings.max_queued
        if not waiting or len(self._taken) >= room:
            return None
        self._taken.add(waiting[0].run_id)
        return waiting.popleft()

    def start(self, spec: RunSpec, number: int, avoid: Sequence[str] = ()) -> None:
        """Create the actor of an attempt; see `Executor`."""
        placement, node = self._settings.placement, ""
        if self._cohorts is not None:
            learner, node = self._cohorts.learner_of(spec.run_id)
            placement = replace(placement, learner=learner)
        arguments = spec.to_dict(), self._store, number, placement, self._settings.teachers
        actor = SeedActor.launch(self._settings.per_run, node_strategy(node, avoid), *arguments)
        result = actor.run.remote()
        self._running[result] = _Running(spec.run_id, actor, result)

    def poll(self, seconds: float, *, last: bool) -> Sequence[Report | AttemptEnd]:
        """Return reports and ends of attempts; see `Executor`."""
        ended: list[Any] = []
        if self._running:
            seconds = 0.0 if self._pending else seconds
            ended, _ = ray.wait(list(self._running), num_returns=1, timeout=seconds)
            if ended:  # collect all others that have ended, too
                ended, _ = ray.wait(list(self._running), num_returns=len(self._running), timeout=0)
        elif not self._pending:
            time.sleep(seconds)
        try:
            self._head.check()  # first, since the loss of the head ends all attempts
        except HeadLostError:
            self._connected = False  # further calls would start another Ray instance
            raise
        if self._cohorts is not None:
            self.learners = self._cohorts.update(over=last)
        for result in ended:
            self._end(self._running.pop(result))
        self._collect_reports(self._running.values())
        events, self._pending = self._pending, []
        return events

    def stop(self) -> None:
        """Ask runs that are training to write checkpoints, and kill all others; see `Executor`."""
        silent = [running for running in self._running.values() if not running.has_reported]
        self._collect_reports(silent, UNREACHABLE_PAUSE)  # a run may have begun training since the last poll
        for result, running in list(self._running.items()):
            if running.has_reported:
                running.actor.request_stop.remote()
            else:
                del self._running[result]
                self._leave(running, AttemptEnd(running.run_id, AttemptOutcome.LOST, without_fault=True))

    def close(self) -> None:
        """Kill all actors, unless this process is disconnected from Ray."""
        if self._connected:
            for running in self._running.values():
                ray.kill(running.actor)
            if self._cohorts is not None:
                self._cohorts.close()

    def _collect_reports(self, attempts: Collection[_Running], seconds: float = 0.0) -> None:
        """Receive pending reports, waiting for at most `seconds`, and request the next ones."""
        pending = [running.report for running in attempts if running.report is not None]
        ready = set(ray.wait(pending, num_returns=len(pending), timeout=seconds)[0]) if pending else set()
        for running in attempts:
            if running.report in ready:
                with suppress(RayActorError):  # handled in `_end`
                    self._receive(running, ray.get(running.report))
            if running.report is None or running.report in ready:
                running.report = running.actor.report.remote()

    def _receive(self, running: _Running, report: Report | None) -> None:
        self._silent.end(running.run_id)
        if report is not None:
            running.has_reported = True
            self._pending.append(report)

    def _end(self, running: _Running) -> None:
        """Record the end of a run whose actor has returned, raised or died, or retry an unavailable one."""
        ending = AttemptEnd(running.run_id, AttemptOutcome.STOPPED)
        try:
            files = ray.get(running.result)
        except ActorUnavailableError as error:
            if not self._silent.has_expired(running.run_id):
                time.sleep(UNREACHABLE_PAUSE)
                running.result, running.report = running.actor.run.remote(), None
                self._running[running.result] = running
                return
            ending = self._loss(running, error)
        except (RayActorError, ActorUnschedulableError, *LOSSES) as error:
            ending = self._loss(running, error)
        except RayTaskError as error:  # the error's text contains colour codes
            ending = AttemptEnd(running.run_id, AttemptOutcome.FAILED, reason=visible(str(error)))
        else:
            with suppress(RayActorError, GetTimeoutError):  # keep the previous report
                self._receive(running, ray.get(running.actor.report.remote(), timeout=FINAL_REPORT_SECONDS))
            if files is not None:
                ending = AttemptEnd(running.run_id, AttemptOutcome.DONE, files)
        self._leave(running, ending)

    def _loss(self, running: _Running, error: Exception) -> AttemptEnd:
        self._silent.end(running.run_id)
        without_fault = self._cohorts is not None and self._cohorts.lost_without_fault(running.run_id)
        reason = reason_for_loss(error)
        return AttemptEnd(running.run_id, AttemptOutcome.LOST, reason=reason, without_fault=without_fault)

    def _leave(self, running: _Running, ending: AttemptEnd) -> None:
        self._pending.append(ending)
        self._taken.discard(running.run_id)
        if self._cohorts is not None:
            self._cohorts.leave(running.run_id)
        ray.kill(running.actor)
