"""Covar-GMM (Moulin-Frier et al. 2014, in the form of Portelas et al. 2019)."""

from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar

import numpy as np

from tma_ray.tasks import Episode
from tma_ray.teachers.mixtures import Mixture, MixtureTeacher
from tma_ray.teachers.numerics import Array


class CovarianceProgress(StrEnum):
    """Measure of learning progress based on the covariance of time and return.

    Attributes:
        ABSOLUTE: absolute value, so that forgetting counts as much as learning.
        POSITIVE: covariance, or 0 if negative.
    """

    ABSOLUTE = "absolute"
    POSITIVE = "positive"


@dataclass
class CovarGMM(MixtureTeacher):
    """Teacher that samples a Gaussian mixture where the returns of recent tasks change with time.

    Time and return are further coordinates of each task; a component is chosen in proportion to their
    covariance. Time is the index of the episode in a fit, scaled to [0, 1).

    Sources: Moulin-Frier et al. 2014; Portelas et al. 2019, appendix; paper, appendix A and table of
    hyper-parameters. The paper takes the absolute value, the original release by default does not.

    Attributes:
        progress: progress as a function of the covariance.
    """

    algorithm_version: ClassVar[int | None] = 1

    most_components: int = 15
    explore: float = 0.1
    progress: CovarianceProgress = CovarianceProgress.ABSOLUTE

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.progress not in list(CovarianceProgress):
            raise ValueError(f"progress = {self.progress!r}: expected {' or '.join(CovarianceProgress)}")

    def measure(self, episode: Episode) -> tuple[float, float]:
        """Return the time of `episode` in the current fit, and its episodic return."""
        return self.episodes_ % self.fit_every / self.fit_every, episode.episodic_return

    def progress_of(self, mixture: Mixture) -> Array:
        """Return the learning progress (k,) of the components, in units of the return."""
        covariance = mixture.covariances[:, -2, -1]
        if self.progress == CovarianceProgress.ABSOLUTE:
            return np.abs(covariance)
        return covariance.clip(min=0)
