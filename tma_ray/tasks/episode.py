"""What a teacher is told: episodes, and the answers to its questions."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

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


class QueryKind(StrEnum):
    """What a teacher may ask of the run between `observe` and the next `sample`."""

    STATE_VALUES = "state_values"
    """V(s) of observations under the current student."""


@dataclass(frozen=True)
class Query:
    """A question from a teacher, answered with one float per row of `observations`.

    Attributes:
        kind: what is asked.
        observations: float32 (n, o), raw as the environment gave them.
    """

    kind: QueryKind
    observations: NDArray[np.float32]


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
    """What a teacher says of itself after an update, drawable for any teacher."""

    gaussians: tuple[WeightedGaussian, ...] = ()
    boxes: tuple[ScoredBox, ...] = ()
    scalars: dict[str, float] = field(default_factory=dict)
