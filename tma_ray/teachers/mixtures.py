"""Gaussian mixtures selected by AIC, used as task distributions by the GMM teachers."""

import warnings
from abc import abstractmethod
from collections import deque
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from threadpoolctl import threadpool_limits

from tma_ray.support.validation import check_at_least, check_shares
from tma_ray.tasks import (
    Episode,
    ExpertKnowledge,
    KnowledgeLevel,
    Task,
    TaskSpace,
    TeacherUpdate,
    WeightedGaussian,
)
from tma_ray.teachers.base import Teacher
from tma_ray.teachers.numerics import Array, draw_in_proportion, shares_of


@dataclass(frozen=True, eq=False)
class Mixture:
    """Fitted Gaussian mixture with weights (k,), means (k, c) and covariances (k, c, c)."""

    weights: Array
    means: Array
    covariances: Array

    def __len__(self) -> int:
        return len(self.weights)

    def draw(self, component: int, rng: np.random.Generator) -> Array:
        """Draw a point (c,) from the component with index `component`."""
        factor = np.linalg.cholesky(self.covariances[component])
        drawn: Array = self.means[component] + factor @ rng.standard_normal(self.means.shape[1])
        return drawn


NARROWEST, WIDEST = 2.0**-6, 2.0**12
"""Smallest and largest width of a dimension that is fitted without scaling. scikit-learn adds 1e-6 to every
variance, too much for narrower dimensions, and lost to rounding in wider ones."""


def units_of(widths: Array) -> Array:
    """Return the units (d,) in which a fit measures dimensions of the given `widths` (d,).

    These are 1 or, for narrow and wide dimensions, the nearest power of two, which does not round.
    """
    scaled = (widths > 0) & ((widths < NARROWEST) | (widths > WIDEST))
    return np.exp2(np.round(np.log2(widths, out=np.zeros_like(widths), where=scaled)))


def fit_mixture(rows: Array, most_components: int, seed: int, units: Array | float = 1.0) -> Mixture:
    """Return the mixture of lowest AIC among fits of 2 to `most_components` full-covariance components.

    Each fit has one initialisation without warm start, and one thread, for bitwise reproducibility.

    Args:
        rows: data (n, c), to which at most n - 1 components are fitted.
        most_components: largest number of components.
        seed: seed of scikit-learn's initialisation.
        units: units (c,) in which the columns are fitted; the result is in those of `rows`.
    """
    # deferred, so that listing teachers does not import scikit-learn
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.mixture import GaussianMixture

    sizes, rows = range(2, min(most_components, len(rows) - 1) + 1), rows / units
    with threadpool_limits(limits=1), warnings.catch_warnings():
        # with few or identical rows, components may be empty, and EM may not converge
        warnings.simplefilter("ignore", ConvergenceWarning)
        fits = [GaussianMixture(size, covariance_type="full", random_state=seed).fit(rows) for size in sizes]
        best = min(fits, key=lambda fit: float(fit.aic(rows)))
    scales = np.broadcast_to(units, rows.shape[1:])
    return Mixture(best.weights_, best.means_ * scales, best.covariances_ * np.outer(scales, scales))


@dataclass
class MixtureTeacher(Teacher):
    """Teacher that samples the components of a Gaussian mixture in proportion to their learning progress.

    Every `fit_every` episodes the mixture is fitted to the latest rows of a task and the values of `measure`.
    Before the first fit tasks are uniform or, at high expert knowledge, from the initial Gaussian.

    Sources: Portelas et al. 2019, algorithm 1; paper, appendix A and table of hyper-parameters. The original
    release tries `most_components` - 1 components at most, the paper includes the maximum.

    Attributes:
        fit_every: episodes between two fits, and rows of each (paper: n).
        most_components: largest number of components (paper: max_k).
        explore: share of uniform tasks after the first fit, in [0, 1] (paper: r_p).
    """

    overlapping: ClassVar[bool] = True

    knowledge_levels: ClassVar[tuple[KnowledgeLevel, ...]] = (KnowledgeLevel.NONE, KnowledgeLevel.HIGH)

    fit_every: int = 150
    most_components: int = 10
    explore: float = 0.05

    def __post_init__(self) -> None:
        check_at_least(self, 3, "fit_every")  # a fit of two components needs three rows
        check_at_least(self, 2, "most_components")
        check_shares(self, "explore")

    @abstractmethod
    def measure(self, episode: Episode) -> tuple[float, ...]:
        """Return the values that are fitted together with the task of `episode`."""

    @abstractmethod
    def progress_of(self, mixture: Mixture) -> Array:
        """Return the non-negative learning progress (k,) of the components."""

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        """Start with an empty history."""
        super().start(space, knowledge, rng)
        self.fit_seed_ = int(rng.integers(2**31))
        self.recent_: deque[Array] = deque(maxlen=self.fit_every)
        self.episodes_ = 0
        self.mixture_: Mixture | None = None

    def sample(self) -> Task:
        """Return a task (d,) from the mixture or, with probability `explore`, a uniform one.

        Before the first fit it is uniform or, at high expert knowledge, from the initial Gaussian.
        """
        if self.mixture_ is None:
            return self._bootstrap(self.rng)
        if self.rng.random() < self.explore:
            return self.space.sample(self.rng)
        return self._exploit(self.mixture_, self.rng)

    def observe(self, episode: Episode) -> None:
        """Store the task with its measured values, and fit a new mixture when due."""
        self.recent_.append(np.array([*episode.task, *self.measure(episode)], dtype=np.float64))
        self.episodes_ += 1
        if self.episodes_ % self.fit_every == 0:
            rows = np.array(self.recent_)
            measured = np.ones(rows.shape[1] - self.space.size)
            units = np.concatenate([units_of(self.space.width), measured])
            self.mixture_ = fit_mixture(rows, self.most_components, self.fit_seed_, units)
            # logged weights are the components' sampling probabilities, not the fitted weights
            mixture, size, progress = self.mixture_, self.space.size, self.progress_of(self.mixture_)
            parts = zip(shares_of(progress), mixture.means, mixture.covariances, strict=True)
            gaussians = tuple(WeightedGaussian(float(w), m[:size], c[:size, :size]) for w, m, c in parts)
            scalars = {
                "components": float(len(mixture)),
                "mean_progress": float(mixture.weights @ progress),
                "largest_progress": float(progress.max()),
            }
            self.log(TeacherUpdate(gaussians=gaussians, scalars=scalars))

    def probe(self, count: int) -> Task:
        """Return `count` tasks (count, d) from the mixture or, before the first fit, as in `sample`."""
        rng = self.probe_rng()
        if self.mixture_ is None:
            return np.stack([self._bootstrap(rng) for _ in range(count)])
        return np.stack([self._exploit(self.mixture_, rng) for _ in range(count)])

    def _bootstrap(self, rng: np.random.Generator) -> Task:
        if self.knowledge.level is KnowledgeLevel.HIGH:
            return self.knowledge.initial.sample(self.space, rng)
        return self.space.sample(rng)

    def _exploit(self, mixture: Mixture, rng: np.random.Generator) -> Task:
        component = draw_in_proportion(self.progress_of(mixture), rng)
        return self.space.clip(mixture.draw(component, rng)[: self.space.size])
