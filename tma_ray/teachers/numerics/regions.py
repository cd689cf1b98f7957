"""Regions of the task space, and the search for where to cut one in two."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tma_ray.tasks import Task

Array = NDArray[np.float64]


class Cut(NamedTuple):
    """A cut across `dimension`: tasks up to `threshold`, a float32, lie left of it, the others right."""

    dimension: int
    threshold: float


@dataclass(frozen=True)
class Split:
    """Division of a region: its cut, and the indices of its left and right part."""

    cut: Cut
    left: int
    right: int


class Region:
    """A closed box of float32 tasks, and the latest episodes in it.

    Attributes:
        bounds: its lower and upper corner (2, d), float32 values.
        tasks: the latest `capacity` tasks, oldest first.
        returns: their episodic returns.
        split: how it was divided; None as long as it is whole.
    """

    def __init__(self, bounds: Array, capacity: int) -> None:
        self.bounds = bounds
        self.tasks: deque[Task] = deque(maxlen=capacity)
        self.returns: deque[float] = deque(maxlen=capacity)
        self.split: Split | None = None
        self._origin = 0.0
        self._sums: deque[float] = deque([0.0], maxlen=capacity + 1)

    def __len__(self) -> int:
        return len(self.returns)

    @property
    def full(self) -> bool:
        """True if it holds as many episodes as it can."""
        return len(self.returns) == self.returns.maxlen

    @property
    def progress(self) -> float:
        """Absolute learning progress: |mean return of the later half - of the earlier half|.

        With an odd number the earlier half has one more; 0 for up to 2 episodes. Taken from running
        sums, so that its cost does not depend on the number of episodes.
        """
        count = len(self.returns)
        if count <= 2:
            return 0.0
        later = count // 2
        middle = self._sums[-1 - later]
        return abs((self._sums[-1] - middle) / later - (middle - self._sums[0]) / (count - later))

    def add(self, task: Task, episodic_return: float) -> None:
        """Appends an episode; the oldest one makes room for it."""
        if not self.returns:
            self._origin = episodic_return  # sums count from it: equal returns make exactly no progress
        self.tasks.append(task)
        self.returns.append(episodic_return)
        self._sums.append(self._sums[-1] + (episodic_return - self._origin))

    def forget(self, count: int) -> None:
        """Drops the oldest `count` episodes."""
        for _ in range(count):
            self.tasks.popleft()
            self.returns.popleft()
            self._sums.popleft()

    def worst_task(self) -> Task:
        """Returns the task with the lowest return, the oldest of several."""
        return self.tasks[int(np.argmin(self.returns))]

    def parts(self, cut: Cut) -> tuple[Region, Region]:
        """Returns the regions left and right of `cut`, each with the episodes that lie in it."""
        capacity = self.returns.maxlen
        assert capacity is not None
        left, right = Region(self.bounds.copy(), capacity), Region(self.bounds.copy(), capacity)
        left.bounds[1, cut.dimension] = cut.threshold
        right.bounds[0, cut.dimension] = np.nextafter(np.float32(cut.threshold), np.float32(np.inf))
        for task, episodic_return in zip(self.tasks, self.returns, strict=True):
            (left if task[cut.dimension] <= cut.threshold else right).add(task, episodic_return)
        return left, right


def best_cut(
    region: Region, attempts: int, fewest: int, smallest: Array, rng: np.random.Generator
) -> Cut | None:
    """Returns the best valid one of `attempts` random cuts of `region`; None if none is valid.

    The score of a cut is |ALP left - ALP right| times the episodes left times those right (Portelas et
    al. 2019, appendix; Baranes and Oudeyer 2009).

    Args:
        region: what to cut.
        attempts: number of random cuts.
        fewest: episodes that each part must keep.
        smallest: (d,) sides that each part must keep, in task units.
        rng: draws the cuts.
    """
    tasks = np.array(region.tasks)
    dimensions, thresholds = random_cuts(region.bounds, tasks, attempts, fewest, rng)
    if not len(dimensions):
        return None
    left = (tasks[:, dimensions] <= thresholds).T
    scores = cut_scores(left, np.array(region.returns))
    sides = np.abs(thresholds - region.bounds[:, dimensions]).min(axis=0)
    scores[sides < smallest[dimensions]] = -1
    best = int(np.argmax(scores))
    return Cut(int(dimensions[best]), float(thresholds[best])) if scores[best] >= 0 else None


def random_cuts(
    bounds: Array, tasks: Task, count: int, fewest: int, rng: np.random.Generator
) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
    """Returns dimensions and thresholds of `count` random cuts; none if the tasks coincide too much.

    Their distribution is that of a uniform dimension and a uniform threshold in the box `bounds`
    (2, d), drawn again until each part keeps `fewest` of the tasks (n, d). Such thresholds lie between
    two order statistics, so nothing needs to be drawn again.
    """
    ordered = np.sort(tasks, axis=0)
    least, most = ordered[fewest - 1], np.nextafter(ordered[-fewest], np.float32(-np.inf))
    room = (most.astype(np.float64) - least).clip(min=0)
    width = bounds[1] - bounds[0]
    chances = np.where(width > 0, room / np.where(width > 0, width, 1.0), 0.0)
    if not chances.any():
        return np.empty(0, dtype=np.intp), np.empty(0, dtype=np.float32)
    dimensions = rng.choice(len(room), size=count, p=chances / chances.sum())
    thresholds = least[dimensions] + rng.random(count) * room[dimensions]
    return dimensions, thresholds.astype(np.float32)


def cut_scores(left: NDArray[np.bool_], returns: Array) -> Array:
    """Returns the scores (c,) of cuts that put the episodes `left` (c, n), oldest first, to the left."""
    populations = left.sum(axis=1) * (~left).sum(axis=1)
    difference = _progress(left, returns) - _progress(~left, returns)
    scores: Array = populations * np.abs(difference)
    return scores


def _progress(members: NDArray[np.bool_], returns: Array) -> Array:
    """Returns what `Region.progress` is (c,) for the parts with the given `members` (c, n)."""
    count = members.sum(axis=1)
    later = count // 2
    earlier = count - later
    is_later = members & (members.cumsum(axis=1) > earlier[:, None])
    gains = returns - returns[0]
    later_mean = np.where(is_later, gains, 0.0).sum(axis=1) / later.clip(min=1)
    earlier_mean = np.where(members & ~is_later, gains, 0.0).sum(axis=1) / earlier.clip(min=1)
    return np.where(count > 2, np.abs(later_mean - earlier_mean), 0.0)
