"""The messages to a teacher: episodes, and the answers to its queries."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from tma_ray.tasks.space import Task

MASTERY_RETURN = 230.0
"""A task is mastered by an episodic return strictly over this (paper, section 4 and appendix C)."""


@dataclass(frozen=True)
class Episode:
    """One finished training episode.

    Attributes:
        task: the task as the teacher chose it, float32 (d,).
        episodic_return: undiscounted sum of the environment's own rewards.
        success: whether `episodic_return` was over the mastery threshold.
        length: steps played.
        initial_observation: the observation that `reset` gave, float32 (o,).
        discounted_return: sum of rewards discounted by the student's gamma.
        step: environment steps of the run so far, this episode included.
    """

    task: Task
    episodic_return: float
    success: bool
    length: int
    initial_observation: NDArray[np.float32]
    discounted_return: float
    step: int


@dataclass(frozen=True, eq=False)
class Trajectory:
    """All steps of one episode, t of them.

    Attributes:
        observations: float32 (t + 1, o), raw, from the initial one to the one after the last step.
        actions: float32 (t, a), as the student chose them.
        rewards: float64 (t,), the environment's own.
        terminated: whether the episode ended by itself; else it was cut, and the value of the last
            observation still counts.
    """

    observations: NDArray[np.float32]
    actions: NDArray[np.float32]
    rewards: NDArray[np.float64]
    terminated: bool


class QueryKind(StrEnum):
    """Kinds of queries that a teacher may make between `observe` and the next `sample`."""

    STATE_VALUES = "state_values"
    """V(s) of observations under the current student: float64 (n,)."""

    TRAJECTORY = "trajectory"
    """The `Trajectory` of the episode just observed; for teachers that declare `wants_trajectory`."""


@dataclass(frozen=True)
class Query:
    """A question from a teacher.

    Attributes:
        kind: what is asked.
        observations: float32 (n, o), raw as the environment gave them, for `STATE_VALUES` only.
    """

    kind: QueryKind
    observations: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        if (self.observations is not None) != (self.kind is QueryKind.STATE_VALUES):
            raise ValueError(
                f"a query for {self.kind.value} "
                + ("takes no observations" if self.observations is not None else "needs observations (n, o)")
            )


Answer: TypeAlias = NDArray[np.float64] | Trajectory
"""What a query is answered with, depending on its kind."""


@dataclass(frozen=True)
class WeightedGaussian:
    """A mixture component of a teacher's task distribution: weight, mean (d,), covariance (d, d)."""

    weight: float
    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]


@dataclass(frozen=True)
class ScoredBox:
    """A region of a teacher's task distribution: low (d,), high (d,), score."""

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    score: float


@dataclass(frozen=True)
class TeacherUpdate:
    """State of a teacher after an update, drawable for any teacher."""

    gaussians: tuple[WeightedGaussian, ...] = ()
    boxes: tuple[ScoredBox, ...] = ()
    scalars: dict[str, float] = field(default_factory=dict)
