"""Protocol of executors, which start attempts at runs, report on them and stop them."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from tma_ray.results import AttemptOutcome, LearnerProgress, PartFile, StorageError
from tma_ray.runs.attempt import Report
from tma_ray.runs.spec import RunSpec
from tma_ray.students.rollout_workers import CohortFullError, LearnerLostError

LOSSES = StorageError, LearnerLostError, CohortFullError
"""Errors after which a run is lost rather than failed, since another attempt may succeed."""


@dataclass(frozen=True)
class AttemptEnd:
    """Outcome of an attempt that has ended, with its result files or the reason for its end.

    Attributes:
        run_id: id of the run.
        outcome: outcome of the attempt.
        files: canonical result files of a run that is done.
        reason: traceback of a failure, or one line about a loss.
        without_fault: True for a loss that the run did not cause; such losses are not counted.
    """

    run_id: str
    outcome: AttemptOutcome
    files: tuple[PartFile, ...] = ()
    reason: str = ""
    without_fault: bool = False


class Executor(Protocol):
    """Executor of concurrent attempts at runs; retries and commits are left to the scheduler."""

    @property
    def learners(self) -> Sequence[LearnerProgress]:
        """Progress of the learners of cohorts."""

    def take(self, waiting: deque[RunSpec]) -> RunSpec | None:
        """Remove and return a run of `waiting` that can start now, or return None."""

    def start(self, spec: RunSpec, number: int, avoid: Sequence[str] = ()) -> None:
        """Start attempt `number` at a run that `take` returned, preferably not on the nodes in `avoid`."""

    def poll(self, seconds: float, *, last: bool) -> Sequence[Report | AttemptEnd]:
        """Wait for at most `seconds`, and return new reports and ends of attempts.

        The last report of an attempt comes before its end. `last` is True if no other run will start.

        Raises:
            HeadLostError: if the cluster is lost, with all attempts.
        """

    def stop(self) -> None:
        """Ask every attempt to write a checkpoint and end.

        Attempts that have not begun to train are killed, and lost without fault.
        """

    def close(self) -> None:
        """Kill all attempts and learners."""
