"""ALP-GMM (Portelas et al. 2019)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tma_ray.tasks import Episode, ExpertKnowledge, TaskSpace
from tma_ray.teachers.mixture_teacher import MixtureTeacher
from tma_ray.teachers.numerics.learning_progress import AbsoluteLearningProgress
from tma_ray.teachers.numerics.mixtures import Array, Mixture


@dataclass
class ALPGMM(MixtureTeacher):
    """Samples where the absolute learning progress of recent tasks is high.

    The mixture is fitted on the latest tasks, each with its absolute learning progress (ALP) as a
    further coordinate; a component is chosen in proportion to its mean ALP.

    Sources: Portelas et al. 2019, algorithm 1; paper, appendix A and table of hyper-parameters.

    Attributes:
        fit_every: episodes between two fits, and rows in each (paper: n).
        most_components: largest mixture tried (paper: max_k).
        explore: share of uniform tasks after the first fit, in [0, 1] (paper: r_p).
    """

    algorithm_version: ClassVar[int | None] = 1

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        """Starts with an empty history."""
        super().start(space, knowledge, rng)
        self.learning_progress_ = AbsoluteLearningProgress(space.size)

    def measure(self, episode: Episode) -> tuple[float]:
        """Returns the ALP of `episode`, and stores it."""
        return (self.learning_progress_(episode.task, episode.episodic_return),)

    def progress_of(self, mixture: Mixture) -> Array:
        """Returns the mean ALP (k,) of each component."""
        return mixture.means[:, -1].clip(min=0)
