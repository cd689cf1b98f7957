"""Runs in processes of this machine, without Ray: alone, or as players of a cohort."""

from __future__ import annotations

import multiprocessing
import os
import queue
import secrets
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing.context import SpawnProcess
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

from tma_ray.results import AttemptOutcome, Committer, leave_pandas_out
from tma_ray.runs.attempt import run_locally
from tma_ray.runs.inputs import keep
from tma_ray.runs.placement import Placement, Status
from tma_ray.runs.spec import RunSpec
from tma_ray.students import Learner
from tma_ray.students.players import CohortSettings, LearnerLostError

REPORT_SECONDS = 2.0
"""Shortest time between two reports of a run, s."""

_SPAWN = multiprocessing.get_context("spawn")


@dataclass
class PoolReport:
    """Progress of a pool.

    Attributes:
        steps: environment steps that each run has reached, by its id.
        played: environment steps of all runs since the pool began.
        outcomes: of the runs that have ended, by id.
        errors: messages of runs that failed, by id.
        seconds: since the pool began, s.
    """

    steps: dict[str, int] = field(default_factory=dict)
    played: int = 0
    outcomes: dict[str, AttemptOutcome] = field(default_factory=dict)
    errors: dict[str, str] = field(default_factory=dict)
    seconds: float = 0.0


@dataclass(frozen=True)
class _Job:
    """All that a process of the pool is given."""

    root: str
    placement: Placement
    specs: Any
    news: Any
    stop: Event


def run_in_processes(
    specs: Sequence[RunSpec],
    root: str | Path,
    processes: int,
    placement: Placement | None = None,
    should_stop: Callable[[], bool] = lambda: False,
    on_report: Callable[[PoolReport], None] = lambda _: None,
) -> PoolReport:
    """Executes runs, each in one of several processes at a time; resumes what an earlier call left.

    The caller holds the root's lease. A run that raises is marked as failed, and the others go on; a process
    that dies ends its own run only, which resumes with the next call.

    Args:
        specs: the runs, in the order in which they are begun.
        root: results root.
        processes: how many runs there are at a time.
        placement: of every run.
        should_stop: asked about every second; once true, runs leave with a checkpoint.
        on_report: told the progress about every second.
    """
    keep(Committer.open(root).store, specs)  # where the processes find the files that runs read
    report, started = PoolReport(), time.monotonic()
    job = _Job(str(root), placement or Placement(), _SPAWN.Queue(), _SPAWN.Queue(), _SPAWN.Event())
    for spec in specs:
        job.specs.put(spec.to_dict())
    workers = [_SPAWN.Process(target=_work, args=(job,)) for _ in range(min(processes, len(specs)))]
    with _one_thread():
        for worker in workers:
            worker.start()
    try:
        while any(worker.is_alive() for worker in workers) or not job.news.empty():
            _take_news(job.news, report)
            report.seconds = time.monotonic() - started
            on_report(report)
            if should_stop():
                job.stop.set()
    finally:
        job.specs.cancel_join_thread()
        for worker in workers:
            worker.kill()
            worker.join()
    return report


@contextmanager
def _one_thread() -> Iterator[None]:
    """Lets processes that start in the block use one thread each for products of arrays."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def _take_news(news: Any, report: PoolReport) -> None:
    """Waits a second for news, and takes in all that have come."""
    try:
        message = news.get(timeout=1.0)
        while True:
            kind, run_id, value = message
            if kind == "step":
                report.played += value - report.steps.get(run_id, value)
                report.steps[run_id] = value
            elif kind == "error":
                report.errors[run_id] = value
            else:
                report.outcomes[run_id] = AttemptOutcome(value)
            message = news.get_nowait()
    except queue.Empty:
        return


def _work(job: _Job) -> None:
    """Executes runs until none is left or a stop is asked for."""
    leave_pandas_out()
    job.placement.give_way()
    committer = Committer.open(job.root)
    while not job.stop.is_set():
        try:
            spec = RunSpec.from_dict(job.specs.get(timeout=0.5))
        except queue.Empty:
            return
        reporter = _Reporter(job.news, spec.run_id)
        try:
            outcome = run_locally(spec, committer, job.placement, job.stop.is_set, reporter)
        except LearnerLostError:
            job.news.put(("outcome", spec.run_id, AttemptOutcome.LOST.value))
            return
        except Exception as error:
            job.news.put(("error", spec.run_id, f"{type(error).__name__}: {error}"))
            outcome = AttemptOutcome.FAILED
        job.news.put(("outcome", spec.run_id, outcome.value))


class _Reporter:
    """Sends the step of a run, not too often."""

    def __init__(self, news: Any, run_id: str) -> None:
        self._news, self._run_id, self._sent = news, run_id, 0.0

    def __call__(self, status: Status) -> None:
        if time.monotonic() - self._sent > REPORT_SECONDS:
            self._sent = time.monotonic()
            self._news.put(("step", self._run_id, status.step))


@contextmanager
def cohort(settings: CohortSettings) -> Iterator[Learner]:
    """Provides a learner in a process of its own, for the placement of runs; ends it with the block."""
    with tempfile.TemporaryDirectory() as folder:
        learner = Learner(f"{folder}/learner", secrets.token_bytes(32))
        process = multiprocessing.get_context("spawn").Process(
            target=_learn, args=(learner, settings), daemon=True
        )
        process.start()
        _wait_for(learner, process)
        try:
            yield learner
        finally:
            process.terminate()
            process.join()


def _learn(learner: Learner, settings: CohortSettings) -> None:
    from tma_ray.students.cohort.server import LearnerServer

    LearnerServer(learner, settings).serve(lambda: False)


def _wait_for(learner: Learner, process: SpawnProcess) -> None:
    while not Path(learner.address).exists():
        if not process.is_alive():
            raise RuntimeError(f"the learner ended with exit code {process.exitcode} before it listened")
        time.sleep(0.05)
