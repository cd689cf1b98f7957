"""The baseline every teacher is compared with."""

from __future__ import annotations

from dataclasses import dataclass

from tma_ray.tasks import Task
from tma_ray.teachers.base import Teacher


@dataclass
class Random(Teacher):
    """Samples uniformly over the task space (paper, appendix A); no expert knowledge changes it."""

    def sample(self) -> Task:
        """Returns a uniform task (d,)."""
        return self.space.sample(self.rng)

    def probe(self, count: int) -> Task:
        """Returns `count` uniform tasks (count, d)."""
        return self.space.sample(self.probe_rng(), count)
