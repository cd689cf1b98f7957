"""The contract of executors: they start attempts at runs, report on them, and stop them."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from tma_ray.results import AttemptOutcome, LearnerProgress, PartFile, StorageError
from tma_ray.runs.attempt import Report
from tma_ray.runs.spec import RunSpec
from tma_ray.students.rollout_workers import CohortFullError, LearnerLostError

LOSSES = StorageError, LearnerLostError, CohortFullError
"""Errors of a run by which its attempt counts as lost: another one may succeed."""


@dataclass(frozen=True)
class Ending:
    """End of an attempt.

    Attributes:
        run_id: id of the run.
        outcome: outcome of the attempt.
        files: canonical result files of a run that is done.
        reason: traceback of a run that failed, or reason for a loss in one line.
        without_fault: True for a loss that the run did not cause: it is repeated, and not counted.
    """

    run_id: str
    outcome: AttemptOutcome
    files: tuple[PartFile, ...] = ()
    reason: str = ""
    without_fault: bool = False


class Executor(Protocol):
    """Executor of attempts at runs, several at a time; it decides no retries and commits no results."""

    @property
    def learners(self) -> Sequence[LearnerProgress]:
        """Progress of the learners of cohorts."""

    def take(self, waiting: deque[RunSpec]) -> RunSpec | None:
        """Remove from `waiting` a run that can start now and return it; None without room."""

    def start(self, spec: RunSpec, number: int, avoid: Sequence[str] = ()) -> None:
        """Start attempt `number` at a run that `take` returned; nodes to `avoid` come last."""

    def poll(self, seconds: float, *, last: bool) -> Sequence[Report | Ending]:
        """Return new reports and endings, after at most `seconds` if there are none.

        The last report of an attempt that trained comes before its ending. With `last` no run will follow.

        Raises:
            HeadLostError: the cluster is gone, with all attempts.
        """

    def stop(self) -> None:
        """Request a checkpoint of every attempt, after which it ends.

        An attempt that has not begun to train is killed: it is lost without fault.
        """

    def close(self) -> None:
        """Kill all attempts and learners."""
