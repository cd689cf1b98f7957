"""Scores of tasks: estimates of the regret, which the student could have earned in addition."""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from tma_ray.tasks import Trajectory


class Score(StrEnum):
    """Estimates of a task's regret from an episode of it (Jiang et al. 2021b, section 4.1 and appendix)."""

    POSITIVE_VALUE_LOSS = "positive_value_loss"
    """Mean over the steps of the generalised advantage estimates, those below 0 counted as 0."""

    MAX_MC = "max_mc"
    """Highest discounted return that was seen on the task, less the value of its first state."""


def positive_value_loss(trajectory: Trajectory, values: NDArray[np.float64], gae_lambda: float) -> float:
    """Returns the positive value loss of an episode of t steps.

    Args:
        trajectory: the episode.
        values: of its observations (t + 1,); the last one does not count if the episode terminated.
        gae_lambda: lambda of the estimates (arXiv:1506.02438).
    """
    from scipy.signal import lfilter  # imported here: who only names a teacher starts sooner without it

    following = values[1:].copy()
    if trajectory.terminated:
        following[-1] = 0.0
    errors = trajectory.rewards + trajectory.gamma * following - values[:-1]
    advantages = lfilter([1.0], [1.0, -trajectory.gamma * gae_lambda], errors[::-1])
    return float(np.maximum(advantages, 0.0).mean())
