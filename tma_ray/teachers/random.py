"""The baseline every teacher is compared with."""

from dataclasses import dataclass
from typing import ClassVar

from tma_ray.tasks import Task
from tma_ray.teachers.base import Teacher


@dataclass
class Random(Teacher):
    """Uniform tasks of the task space (paper, appendix A); no expert knowledge changes them."""

    overlapping: ClassVar[bool] = True
    algorithm_version: ClassVar[int | None] = 1

    def sample(self) -> Task:
        """Return a uniform task (d,)."""
        return self.space.sample(self.rng)

    def probe(self, count: int) -> Task:
        """Return `count` uniform tasks (count, d)."""
        return self.space.sample(self.probe_rng(), count)
