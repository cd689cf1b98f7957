"""Executor of attempts in processes of this machine, without Ray, for benchmarks and tests."""

import multiprocessing
import os
import secrets
import signal
import tempfile
import time
import traceback
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from tma_ray.campaign.executors.base import LOSSES, AttemptEnd
from tma_ray.results import AttemptOutcome, LearnerProgress, PartFile, Store
from tma_ray.runs.attempt import Attempt, Report
from tma_ray.runs.placement import Placement
from tma_ray.runs.spec import RunSpec
from tma_ray.students import Learner
from tma_ray.students.rollout_workers import CohortSettings
from tma_ray.support.import_hacks import skip_pandas

REPORT_SECONDS = 2.0  # shortest time between two reports of an attempt without a new checkpoint, s

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables that limit the threads of matrix products."""

_SPAWN = multiprocessing.get_context("spawn")


class LearnerProcess:
    """Learner of a cohort in a separate process, listening once constructed.

    Raises:
        RuntimeError: if its process ends before it listens.
    """

    def __init__(self, settings: CohortSettings) -> None:
        self._folder = tempfile.TemporaryDirectory()
        self.learner = Learner(f"{self._folder.name}/learner", secrets.token_bytes(32))
        self._process = _SPAWN.Process(target=_learn, args=(self.learner, settings), daemon=True)
        self._process.start()
        while not Path(self.learner.address).exists():
            if not self.is_alive():
                code = self._process.exitcode
                raise RuntimeError(f"the learner ended with exit code {code} before it listened")
            time.sleep(0.05)

    def is_alive(self) -> bool:
        """Return True while its process runs."""
        return self._process.is_alive()

    def close(self) -> None:
        """End the process."""
        self._process.terminate()
        self._process.join()
        self._folder.cleanup()


def _learn(learner: Learner, settings: CohortSettings) -> None:
    from tma_ray.students.cohort.server import LearnerServer  # deferred: imports torch

    LearnerServer(learner, settings).serve(lambda: False)


@contextmanager
def cohort(settings: CohortSettings) -> Iterator[Learner]:
    """Context manager of a learner in a separate process, for the placement of runs."""
    with closing(LearnerProcess(settings)) as process:
        yield process.learner


class LocalExecutor:
    """Executor with a new process for each attempt, alone or as rollout workers of one cohort.

    A dead learner is replaced when the next attempt starts.
    """

    learners: Sequence[LearnerProgress] = ()

    def __init__(
        self, store: Store, placement: Placement, processes: int, cohort: CohortSettings | None = None
    ) -> None:
        self._store, self._placement, self._processes, self._cohort = store, placement, processes, cohort
        self._running: dict[Connection, tuple[str, Any, Any]] = {}
        """Id, process and stop event of each attempt, by the connection to its process."""
        self._learner: LearnerProcess | None = None

    def take(self, waiting: deque[RunSpec]) -> RunSpec | None:
        """Return the first run, if a process is free; see `Executor`."""
        return waiting.popleft() if waiting and len(self._running) < self._processes else None

    def start(self, spec: RunSpec, number: int, avoid: Sequence[str] = ()) -> None:  # noqa: ARG002
        """Start the process of an attempt; see `Executor`."""
        placement = self._placement
        if self._cohort is not None:
            if self._learner is not None and not self._learner.is_alive():
                self._learner.close()
                self._learner = None
            self._learner = self._learner or LearnerProcess(self._cohort)
            placement = replace(placement, learner=self._learner.learner)
        parent_end, child_end = _SPAWN.Pipe()
        stop = _SPAWN.Event()
        arguments = child_end, stop, spec.to_dict(), self._store, number, placement
        process = _SPAWN.Process(target=_execute, args=arguments, daemon=True)
        with _one_thread():
            process.start()
        child_end.close()
        self._running[parent_end] = spec.run_id, process, stop

    def poll(self, seconds: float, *, last: bool) -> Sequence[Report | AttemptEnd]:  # noqa: ARG002
        """Return the reports and endings of processes; see `Executor`."""
        if not self._running:
            time.sleep(seconds)
        events: list[Report | AttemptEnd] = []
        for connection in wait(list(self._running), seconds) if self._running else ():
            assert isinstance(connection, Connection)
            run_id, process, _ = self._running[connection]
            try:
                events.append(connection.recv())
            except (EOFError, OSError):  # the process is dead
                process.join()
                reason = f"its process ended with exit code {process.exitcode}"
                events.append(AttemptEnd(run_id, AttemptOutcome.LOST, reason=reason))
            if isinstance(events[-1], AttemptEnd):
                del self._running[connection]
                connection.close()
                process.join()
        return events

    def stop(self) -> None:
        """Request a checkpoint of every attempt; see `Executor`."""
        for _, _, stop in self._running.values():
            stop.set()

    def close(self) -> None:
        """Kill all processes."""
        for _, process, _ in self._running.values():
            process.kill()
            process.join()
        if self._learner is not None:
            self._learner.close()


@contextmanager
def _one_thread() -> Iterator[None]:
    """Context manager in which new processes use one thread each for matrix products."""
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def _execute(
    connection: Connection, stop: Any, spec: dict[str, Any], store: Store, number: int, placement: Placement
) -> None:
    """Execute an attempt in this process, and send reports and the ending."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C also reaches child processes
    skip_pandas()
    placement.give_way()
    attempt = Attempt(RunSpec.from_dict(spec), store, number, placement)
    run_id, sent_at = attempt.spec.run_id, 0.0

    def report(_: Sequence[PartFile] = ()) -> None:
        nonlocal sent_at
        sent_at = time.monotonic()
        connection.send(attempt.report())

    def report_and_ask() -> bool:
        if time.monotonic() - sent_at > REPORT_SECONDS:
            report()
        return bool(stop.is_set())

    try:
        files = attempt.execute(report_and_ask, report)
        report()
        outcome = AttemptOutcome.STOPPED if files is None else AttemptOutcome.DONE
        ending = AttemptEnd(run_id, outcome, files or ())
    except LOSSES as error:
        ending = AttemptEnd(run_id, AttemptOutcome.LOST, reason=str(error))
    except Exception:
        ending = AttemptEnd(run_id, AttemptOutcome.FAILED, reason=traceback.format_exc())
    connection.send(ending)
