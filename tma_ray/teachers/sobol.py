"""Tasks from a low-discrepancy sequence."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tma_ray.tasks import Episode, ExpertKnowledge, Task, TaskSpace
from tma_ray.teachers.base import Teacher
from tma_ray.teachers.numerics import UnitBox

BLOCK_SIZE = 256  # points computed at once; only a power of 2 gives balanced blocks


@dataclass
class Sobol(Teacher):
    """Teacher that proposes a scrambled Sobol sequence, which is more evenly spread than random tasks.

    Sources: Sobol 1967; direction numbers of Joe and Kuo 2008, scrambling of Matousek 1998, as in scipy.
    """

    algorithm_version: ClassVar[int | None] = 1
    single_task: ClassVar[bool] = False

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        """Draw the seed for scrambling the sequence."""
        super().start(space, knowledge, rng)
        self._box = UnitBox(space)
        self.scrambling_ = int(rng.integers(2**31))
        self.drawn_ = 0
        self.block_: NDArray[np.float64] = self._points(0)

    def sample(self) -> Task:
        """Return the next task (d,) in the sequence."""
        task: Task = self._box.denormalise(self.block_[self.drawn_ % BLOCK_SIZE])
        return task

    def observe(self, episode: Episode) -> None:  # noqa: ARG002 - the sequence depends on no episode
        """Advance to the next point."""
        self.drawn_ += 1
        if self.drawn_ % BLOCK_SIZE == 0:
            self.block_ = self._points(self.drawn_)

    def probe(self, count: int) -> Task:
        """Return the next `count` tasks (count, d)."""
        blocks = range(self.drawn_ // BLOCK_SIZE, (self.drawn_ + count - 1) // BLOCK_SIZE + 1)
        points = np.concatenate([self._points(block * BLOCK_SIZE) for block in blocks])
        first = self.drawn_ % BLOCK_SIZE
        return self._box.denormalise(points[first : first + count])

    def _points(self, first: int) -> NDArray[np.float64]:
        """Return the points (BLOCK_SIZE, f) of the sequence from index `first` on."""
        from scipy.stats import qmc  # deferred, so that listing teachers does not import scipy

        sequence = qmc.Sobol(self._box.size, scramble=True, seed=self.scrambling_)
        if first:
            sequence.fast_forward(first)
        points: NDArray[np.float64] = sequence.random(BLOCK_SIZE)
        return points
