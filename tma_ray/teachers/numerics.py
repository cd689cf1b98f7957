"""Numerics that several teachers share: random choices, common units, a set of tasks as a Gaussian."""

from contextlib import AbstractContextManager
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from threadpoolctl import ThreadpoolController

from tma_ray.tasks import Task, TaskSpace, WeightedGaussian

Array = NDArray[np.float64]


@cache  # to look for the libraries takes milliseconds, to set their threads a hundredth of that
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()


def one_thread() -> AbstractContextManager[object]:
    """Context manager with one thread for numpy's matrix products, whose bits then depend on no place.

    Libraries that are loaded after its first use are not limited: where scipy or scikit-learn multiply, use
    `threadpoolctl.threadpool_limits`, which is slower.
    """
    limits: AbstractContextManager[object] = _libraries().limit(limits=1)
    return limits


def draw_in_proportion(scores: ArrayLike, rng: np.random.Generator) -> int:
    """Return an index drawn in proportion to `scores` (k,), none negative; uniform if all are 0."""
    cumulative = np.cumsum(scores)
    total = cumulative[-1]
    if total <= 0:
        return int(rng.integers(len(cumulative)))
    return int(np.searchsorted(cumulative, rng.random() * total, side="right"))


def shares_of(scores: Array) -> Array:
    """Return the chances (k,) that `draw_in_proportion` gives `scores` (k,)."""
    total = scores.sum()
    return scores / total if total > 0 else np.full(len(scores), 1 / len(scores))


def softmax(scores: Array, temperature: float) -> Array:
    """Return the chances (k,) in proportion to exp(scores / temperature)."""
    weights = np.exp((scores - scores.max()) / temperature)
    return np.asarray(weights / weights.sum(), dtype=np.float64)


LOWEST_RETURN, HIGHEST_RETURN = -150.0, 350.0
"""Bounds between which the original release scales returns on Stump Tracks, where a teacher wants that."""


def scaled_returns(returns: Array, lowest: float, highest: float) -> Array:
    """Return `returns` (k,) with `lowest` as 0 and `highest` as 1, and what is beyond them as these.

    Raises:
        ValueError: `lowest` is not below `highest`.
    """
    if not lowest < highest:
        raise ValueError(f"lowest_return = {lowest}: expected a return below highest_return = {highest}")
    return np.clip((returns - lowest) / (highest - lowest), 0.0, 1.0)


def draw_in_box(space: TaskSpace, box: Array, rng: np.random.Generator) -> Task:
    """Return a uniform task (d,) of a `box` in `space`, given by its lower and upper corner (2, d)."""
    low, high = box
    return space.clip(low + rng.random(space.size) * (high - low))


class UnitBox:
    """The dimensions of a space that have width, each scaled to [0, 1].

    Args:
        space: the space; its constant dimensions keep their value.

    Attributes:
        free: bool (d,), which dimensions have width.
        size: number f of them.

    Raises:
        ValueError: no dimension has width.
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
        """Return the free coordinates (..., f) of `tasks` (..., d)."""
        return self._space.normalise(tasks)[..., self.free]

    def denormalise(self, points: Array) -> Task:
        """Return `points` (..., f) as tasks (..., d), clipped to the space."""
        tasks = np.zeros((*points.shape[:-1], self.free.size))
        tasks[..., self.free] = points
        return self._space.denormalise(tasks)


LEAST_STD_SHARE = 1e-3
"""Standard deviation added to every dimension, as a share of its range: single tasks have none."""

CONSTANT_STD = 1e-3  # standard deviation of dimensions without width, in task units


def cloud_gaussian(space: TaskSpace, tasks: Task, weights: Array | None = None) -> WeightedGaussian:
    """Return the Gaussian with mean and covariance of `tasks` (n, d), which `weights` (n,) may weigh."""
    points = tasks.astype(np.float64)
    shares = np.full(len(points), 1 / len(points)) if weights is None else weights / weights.sum()
    mean = shares @ points
    centred = points - mean
    least = np.where(space.width > 0, LEAST_STD_SHARE * space.width, CONSTANT_STD) ** 2
    return WeightedGaussian(1.0, mean, centred.T @ (shares[:, None] * centred) + np.diag(least))
