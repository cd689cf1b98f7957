"""A task space whose regions are cut apart and shuffled: the rugged difficulty landscape."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tma_ray.tasks.space import Task, TaskSpace

CUTS = 4
"""Intervals per dimension (paper, appendix C, rugged difficulty landscape)."""


@dataclass(frozen=True, eq=False)
class ShuffledSpace:
    """The box a teacher works in, and where each of its tasks really lies.

    Every dimension is cut into equal intervals, which change places within it, independently of the
    other dimensions. The teacher sees the same box as before; a smooth path through it jumps wherever
    it leaves an interval. A boundary between two intervals belongs to the lower one.

    Both maps are linear within an interval and never leave the interval they lead to, whatever float32
    rounds away; one undoes the other up to that rounding. Constant dimensions stay as they are.

    Source: paper, appendix C, algorithms for cutting and shuffling and for interpolation.

    Attributes:
        space: the box of the teacher, and of the world.
        order: (d, cuts), the world's interval that each of the teacher's intervals shows.

    Examples:
        >>> line = TaskSpace.from_bounds({"height": (0, 4)})
        >>> swapped = ShuffledSpace(line, np.array([[2, 3, 0, 1]]))
        >>> swapped.to_world([0.5]).tolist(), swapped.from_world([2.5]).tolist()
        ([2.5], [0.5])
    """

    space: TaskSpace
    order: NDArray[np.intp]

    def __post_init__(self) -> None:
        places = np.arange(self.order.shape[-1])
        if self.order.shape != (self.space.size, places.size) or np.any(np.sort(self.order) != places):
            raise ValueError(
                f"order {self.order.tolist()}: expected {self.space.size} rows, each a permutation of the "
                f"intervals 0 to {places.size - 1}"
            )
        crowded = (self.space.width > 0) & np.any(np.diff(self._edges) <= 0, axis=1)
        if np.any(crowded):
            dimension = self.space.dimensions[int(np.argmax(crowded))]
            raise ValueError(
                f"dimension {dimension.name!r} is too narrow to be cut into {places.size} intervals of "
                f"float32 numbers: {dimension.low} to {dimension.high}"
            )

    @classmethod
    def shuffle(cls, space: TaskSpace, rng: np.random.Generator, cuts: int = CUTS) -> ShuffledSpace:
        """Returns `space` with `cuts` intervals per dimension in an order drawn from `rng`.

        Raises:
            ValueError: no cuts, or more than float32 can tell apart in some dimension.
        """
        if cuts < 1:
            raise ValueError(f"cuts = {cuts}: expected at least 1 interval per dimension")
        return cls(space, rng.permuted(np.tile(np.arange(cuts), (space.size, 1)), axis=1))

    def to_world(self, tasks: ArrayLike) -> Task:
        """Returns the tasks (..., d) that the world builds for `tasks` (..., d) of the teacher.

        Raises:
            ValueError: a task outside the space.
        """
        return self._move(tasks, self.order)

    def from_world(self, tasks: ArrayLike) -> Task:
        """Returns the teacher's tasks (..., d) that lead to `tasks` (..., d) of the world.

        Raises:
            ValueError: a task outside the space.
        """
        return self._move(tasks, np.argsort(self.order, axis=1))

    @cached_property
    def _edges(self) -> Task:
        """Bounds of the intervals (d, cuts + 1), the outer ones exactly those of the space."""
        return np.linspace(self.space.low, self.space.high, self.order.shape[1] + 1, axis=1, dtype=np.float32)

    def _move(self, tasks: ArrayLike, order: NDArray[np.intp]) -> Task:
        values = np.asarray(tasks, dtype=np.float32)
        if not self.space.contains(values):
            raise ValueError(
                f"tasks {values.tolist()} exceed the shuffled space: bounds are "
                f"{self.space.low.tolist()} to {self.space.high.tolist()}"
            )
        rows = np.arange(self.space.size)
        here = np.sum(values[..., None] > self._edges[:, 1:-1], axis=-1)
        there = order[rows, here]
        low, high = self._edges[rows, here].astype(np.float64), self._edges[rows, here + 1]
        new_low, new_high = self._edges[rows, there], self._edges[rows, there + 1]
        share = (values - low) / np.where(high > low, high - low, 1.0)
        moved = new_low + share * (new_high.astype(np.float64) - new_low)
        first = np.where(there > 0, np.nextafter(new_low, new_high), new_low)
        inside: Task = np.clip(moved.astype(np.float32), first, new_high)
        return inside
