"""The queries of a teacher, and the answers to them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from tma_ray.tasks.space import Task


@dataclass(frozen=True, eq=False)
class Trajectory:
    """All steps of one episode, t of them.

    Attributes:
        observations: float32 (t + 1, o), raw, from the initial one to the one after the last step.
        actions: float32 (t, a), as the student chose them.
        rewards: float64 (t,), the environment's own.
        terminated: whether the episode ended by itself; else it was cut, and the value of the last
            observation still counts.
        gamma: the student's discount factor, by which it values states.
    """

    observations: NDArray[np.float32]
    actions: NDArray[np.float32]
    rewards: NDArray[np.float64]
    terminated: bool
    gamma: float


@dataclass(frozen=True, eq=False)
class Outcomes:
    """Outcomes of the episodes of an evaluation, one of each of n tasks.

    Attributes:
        episodic_returns: float64 (n,).
        successes: bool (n,), whether each return was over the mastery threshold.
        lengths: int64 (n,), steps played.
    """

    episodic_returns: NDArray[np.float64]
    successes: NDArray[np.bool_]
    lengths: NDArray[np.int64]


class QueryKind(StrEnum):
    """Kinds of queries that a teacher may make between `observe` and the next `sample`."""

    STATE_VALUES = "state_values"
    """V(s) of observations under the current student: float64 (n,)."""

    TRAJECTORY = "trajectory"
    """The `Trajectory` of the episode just observed; for teachers that declare `wants_trajectory`."""

    EVALUATION = "evaluation"
    """The `Outcomes` of one episode of each task, from which the student does not learn; for teachers that
    declare `wants_evaluations`. Their steps count to the budget of the run, which may end in an
    evaluation: then it is not answered."""


@dataclass(frozen=True)
class Query:
    """A question from a teacher.

    Attributes:
        kind: what is asked.
        observations: float32 (n, o), raw as the environment gave them, for `STATE_VALUES` only.
        tasks: float32 (n, d), inside the task space, for `EVALUATION` only; a task may be named repeatedly.
        greedy: whether an evaluation plays the deterministic policy instead of the exploring one.
    """

    kind: QueryKind
    observations: NDArray[np.float32] | None = None
    tasks: Task | None = None
    greedy: bool = False

    def __post_init__(self) -> None:
        for name, kind, shape in (
            ("observations", QueryKind.STATE_VALUES, "(n, o)"),
            ("tasks", QueryKind.EVALUATION, "(n, d)"),
        ):
            given, wanted = getattr(self, name) is not None, self.kind is kind
            if given != wanted:
                raise ValueError(
                    f"a query for {self.kind.value} "
                    + (f"takes no {name}" if given else f"needs {name} {shape}")
                )
        if self.greedy and self.kind is not QueryKind.EVALUATION:
            raise ValueError(f"a query for {self.kind.value} plays nothing: greedy is for evaluations")


Answer: TypeAlias = NDArray[np.float64] | Trajectory | Outcomes
"""What a query is answered with, depending on its kind."""
