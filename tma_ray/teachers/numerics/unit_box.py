"""The part of a task space that a teacher can choose, in common units."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tma_ray.tasks import Task, TaskSpace


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

    def normalise(self, tasks: ArrayLike) -> NDArray[np.float64]:
        """Returns the free coordinates (..., f) of `tasks` (..., d)."""
        return self._space.normalise(tasks)[..., self.free]

    def denormalise(self, points: NDArray[np.float64]) -> Task:
        """Returns `points` (..., f) as tasks (..., d), clipped to the space."""
        tasks = np.zeros((*points.shape[:-1], self.free.size))
        tasks[..., self.free] = points
        return self._space.denormalise(tasks)
