"""Hand-designed schedule from easy tasks to the target distribution, a reference for teachers."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tma_ray.support.validation import check_at_least
from tma_ray.tasks import (
    Episode,
    ExpertKnowledge,
    Gaussian,
    KnowledgeLevel,
    Task,
    TaskSpace,
    TeacherUpdate,
    WeightedGaussian,
)
from tma_ray.teachers.base import DistributionTeacher

LOG_EVERY = 100  # number of episodes between two log rows


@dataclass
class Ramp(DistributionTeacher):
    """Teacher that samples a Gaussian moving from the initial to the target distribution on a schedule.

    Mean and standard deviation change linearly until environment step `steps`; later tasks come from the
    target distribution. It is a reference for the gain of a curriculum whose difficulty lies along the axes.

    Attributes:
        steps: environment steps until the target distribution, by default half of the paper's budget.
    """

    overlapping: ClassVar[bool] = True
    algorithm_version: ClassVar[int | None] = 1
    knowledge_levels: ClassVar[tuple[KnowledgeLevel, ...]] = (KnowledgeLevel.HIGH,)

    steps: int = 10_000_000

    def __post_init__(self) -> None:
        check_at_least(self, 1, "steps")

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        """Start at the initial Gaussian."""
        super().start(space, knowledge, rng)
        self.step_, self.episodes_ = 0, 0
        self._log()

    def draw(self, rng: np.random.Generator, count: int) -> Task:
        """Return `count` tasks (count, d) drawn from the current Gaussian, clipped to the space."""
        return self._gaussian().sample(self.space, rng, count)

    def observe(self, episode: Episode) -> None:
        """Count the episode and its steps."""
        self.step_, self.episodes_ = episode.step, self.episodes_ + 1
        if self.episodes_ % LOG_EVERY == 0:
            self._log()

    def _gaussian(self) -> Gaussian:
        share = self._share
        initial, target = self.knowledge.initial, self.knowledge.target
        mean = (1 - share) * initial.mean + share * target.mean
        deviation = (1 - share) * np.sqrt(initial.variance) + share * np.sqrt(target.variance)
        return Gaussian(mean, deviation**2)

    @property
    def _share(self) -> float:
        """Share of `steps` taken so far, in [0, 1]."""
        return min(1.0, self.step_ / self.steps)

    def _log(self) -> None:
        gaussian = self._gaussian()
        parts = (WeightedGaussian(1.0, gaussian.mean, np.diag(gaussian.variance)),)
        self.log(TeacherUpdate(gaussians=parts, scalars={"share_of_the_way": self._share}))
