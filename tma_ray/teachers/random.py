"""Random tasks, the baseline of all comparisons."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tma_ray.tasks import Task
from tma_ray.teachers.base import DistributionTeacher


@dataclass
class Random(DistributionTeacher):
    """Teacher that samples the task space uniformly, without expert knowledge (paper, appendix A)."""

    overlapping: ClassVar[bool] = True
    algorithm_version: ClassVar[int | None] = 1

    def draw(self, rng: np.random.Generator, count: int) -> Task:
        """Return `count` uniform tasks (count, d)."""
        return self.space.sample(rng, count)
