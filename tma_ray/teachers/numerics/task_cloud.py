"""A weighted set of tasks as a Gaussian, which figures draw."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tma_ray.tasks import Task, TaskSpace, WeightedGaussian

LEAST_STD_SHARE = 1e-3
"""Standard deviation added to every dimension, as a share of its range: single tasks have none."""

CONSTANT_STD = 1e-3
"""Standard deviation of dimensions without width, in task units."""


def cloud_gaussian(
    space: TaskSpace, tasks: Task, weights: NDArray[np.float64] | None = None
) -> WeightedGaussian:
    """Returns the Gaussian with mean and covariance of `tasks` (n, d), which `weights` (n,) may weigh."""
    points = tasks.astype(np.float64)
    shares = np.full(len(points), 1 / len(points)) if weights is None else weights / weights.sum()
    mean = shares @ points
    centred = points - mean
    least = np.where(space.width > 0, LEAST_STD_SHARE * space.width, CONSTANT_STD) ** 2
    return WeightedGaussian(1.0, mean, centred.T @ (shares[:, None] * centred) + np.diag(least))
