"""Random choices that several teachers make alike."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tma_ray.tasks import Task, TaskSpace


def draw_in_proportion(scores: ArrayLike, rng: np.random.Generator) -> int:
    """Returns an index drawn in proportion to `scores` (k,), none negative; uniform if all are 0."""
    cumulative = np.cumsum(scores)
    total = cumulative[-1]
    if total <= 0:
        return int(rng.integers(len(cumulative)))
    return int(np.searchsorted(cumulative, rng.random() * total, side="right"))


def shares_of(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the chances (k,) that `draw_in_proportion` gives `scores` (k,)."""
    total = scores.sum()
    return scores / total if total > 0 else np.full(len(scores), 1 / len(scores))


def draw_in_box(space: TaskSpace, box: NDArray[np.float64], rng: np.random.Generator) -> Task:
    """Returns a uniform task (d,) of a `box` in `space`, given by its lower and upper corner (2, d)."""
    low, high = box
    return space.clip(low + rng.random(space.size) * (high - low))
