"""Numerical functions shared by teachers: random choices, scaling, and Gaussians fitted to tasks."""

from contextlib import AbstractContextManager
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from threadpoolctl import ThreadpoolController

from tma_ray.tasks import Task, TaskSpace, WeightedGaussian

Array = NDArray[np.float64]


@cache  # finding the libraries takes a hundred times as long as setting their numbers of threads
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()


def one_thread() -> AbstractContextManager[object]:
    """Return a context manager that limits numpy's matrix products to one thread, for exact reproducibility.

    Libraries loaded after its first use are not limited: with scipy or scikit-learn, use the slower
    `threadpoolctl.threadpool_limits`.
    """
    limits: AbstractContextManager[object] = _libraries().limit(limits=1)
    return limits


def draw_in_proportion(scores: ArrayLike, rng: np.random.Generator) -> int:
    """Draw an index with probability proportional to non-negative `scores` (k,), uniform if all are 0."""
    cumulative = np.cumsum(scores)
    total = cumulative[-1]
    if total <= 0:
        return int(rng.integers(len(cumulative)))
    return int(np.searchsorted(cumulative, rng.random() * total, side="right"))


def shares_of(scores: Array) -> Array:
    """Return the probabilities (k,) with which `draw_in_proportion` draws indices for `scores` (k,)."""
    total = scores.sum()
    return scores / total if total > 0 else np.full(len(scores), 1 / len(scores))


def softmax(scores: Array, temperature: float) -> Array:
    """Return probabilities (k,) proportional to exp(scores / temperature)."""
    weights = np.exp((scores - scores.max()) / temperature)
    return np.asarray(weights / weights.sum(), dtype=np.float64)


LOWEST_RETURN, HIGHEST_RETURN = -150.0, 350.0  # range of returns on Stump Tracks (original release)


def scaled_returns(returns: Array, lowest: float, highest: float) -> Array:
    """Scale `returns` (k,) from [`lowest`, `highest`] to [0, 1], and clip them.

    Raises:
        ValueError: if `lowest` is not below `highest`.
    """
    if not lowest < highest:
        raise ValueError(f"lowest_return = {lowest}: expected a return below highest_return = {highest}")
    return np.clip((returns - lowest) / (highest - lowest), 0.0, 1.0)


def draw_in_box(space: TaskSpace, box: Array, rng: np.random.Generator) -> Task:
    """Draw a uniform task (d,) from a `box` (2, d), given by its lower and upper corners."""
    low, high = box
    return space.clip(low + rng.random(space.size) * (high - low))


class UnitBox:
    """Transform between tasks and points of a unit box that has only the non-constant dimensions.

    Attributes:
        free: mask of the dimensions that are not constant (d,).
        size: number f of these dimensions.

    Raises:
        ValueError: if no dimension of the space has width.
    """

    def __init__(self, space: TaskSpace) -> None:
        self._space = space
        self.free = space.width > 0
        self.size = int(self.free.sum())
        if not self.size:
            raise ValueError(
                f"no dimension of the task space ({', '.join(space.names)}) has width: "
                f"there is nothing to choose; widen one, or use the teacher 'random'"
            )

    def normalise(self, tasks: ArrayLike) -> Array:
        """Return `tasks` (..., d) as points (..., f) of the unit box."""
        return self._space.normalise(tasks)[..., self.free]

    def denormalise(self, points: Array) -> Task:
        """Return `points` (..., f) as tasks (..., d), clipped to the space."""
        tasks = np.zeros((*points.shape[:-1], self.free.size))
        tasks[..., self.free] = points
        return self._space.denormalise(tasks)


# smallest standard deviations of a Gaussian fitted to tasks
LEAST_STD_SHARE = 1e-3  # as a share of a dimension's range, so that even a single task gives a Gaussian
CONSTANT_STD = 1e-3  # for constant dimensions, in task units


def cloud_gaussian(space: TaskSpace, tasks: Task, weights: Array | None = None) -> WeightedGaussian:
    """Return the Gaussian with the mean and covariance of `tasks` (n, d), optionally weighted (n,)."""
    points = tasks.astype(np.float64)
    shares = np.full(len(points), 1 / len(points)) if weights is None else weights / weights.sum()
    mean = shares @ points
    centred = points - mean
    least = np.where(space.width > 0, LEAST_STD_SHARE * space.width, CONSTANT_STD) ** 2
    return WeightedGaussian(1.0, mean, centred.T @ (shares[:, None] * centred) + np.diag(least))
