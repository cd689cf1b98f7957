"""The messages between a run and its teacher: proposals, episodes and logged updates."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tma_ray.tasks.space import Task

MASTERY_RETURN = 230.0
"""A task is mastered by an episodic return strictly over this (paper, section 4 and appendix C)."""


@dataclass(frozen=True, eq=False)
class Proposal:
    """A task for the next episode.

    Attributes:
        task: float32 (d,), inside the task space.
        trains: whether the student learns from the episode. If not, it plays its exploring policy and does
            not change: nothing is stored, counted or updated. The steps count to the budget all the same.
    """

    task: Task
    trains: bool = True


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
        trains: whether the student learned from it, as the `Proposal` said.
    """

    task: Task
    episodic_return: float
    success: bool
    length: int
    initial_observation: NDArray[np.float32]
    discounted_return: float
    step: int
    trains: bool = True


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
