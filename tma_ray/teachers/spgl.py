"""SPGL, self-paced Gaussian curriculum learning with closed-form updates (Ardakani and Song 2026)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from threadpoolctl import threadpool_limits

from tma_ray.tasks import Episode, ExpertKnowledge, Task, TaskSpace
from tma_ray.teachers.base import PAPER_BUDGET, for_budget, next_due
from tma_ray.teachers.numerics import Array
from tma_ray.teachers.spdl import SPDL, FullGaussian

RIDGE = 1.0  # weight, in episodes, of the prior that returns do not depend on the task


def quadratic_fit(points: Array, returns: Array) -> tuple[Array, Array]:
    """Return the gradient (f,) and Hessian (f, f) at 0 of a quadratic fitted by ridge regression.

    Args:
        points: points (n, f), in coordinates of unit scale.
        returns: returns (n,).
    """
    size = points.shape[1]
    rows, columns = np.triu_indices(size)
    features = np.hstack([points, points[:, rows] * points[:, columns]])
    features -= features.mean(axis=0)
    gram = features.T @ features + RIDGE * np.eye(features.shape[1])
    weights = np.linalg.solve(gram, features.T @ (returns - returns.mean()))
    curvature = np.zeros((size, size))
    curvature[rows, columns] = weights[size:]
    return weights[:size], curvature + curvature.T


@dataclass(frozen=True, eq=False)
class ClosedForm:
    """Closed-form update of a Gaussian, given a quadratic model of returns.

    The Gaussian q with a `weight` maximises E_q[J] - penalty KL(q || target) - weight KL(q || current), where
    J has gradient g and Hessian H at 0, and the current distribution is the standard Gaussian. Its
    precision is (penalty P + weight I - H) / (penalty + weight), and its mean the inverse precision times
    (penalty P m + g) / (penalty + weight), with P the precision and m the mean of the target.
    """

    gradient: Array  # gradient g (f,)
    curvature: Array  # Hessian H (f, f)
    target: FullGaussian  # target distribution
    penalty: float  # weight of the divergence from the target, at least 0

    def best(self, weight: float) -> FullGaussian | None:
        """Return the Gaussian that maximises the objective, or None if it is unbounded."""
        size, total = len(self.gradient), self.penalty + weight
        inverse = np.linalg.inv(self.target.factor)
        pull = self.penalty * inverse.T @ inverse
        precision = pull + weight * np.eye(size) - self.curvature
        if total <= 0 or np.linalg.eigvalsh(precision)[0] <= 0:
            return None
        covariance = np.linalg.inv(precision)
        mean = covariance @ (pull @ self.target.mean + self.gradient)
        factor = np.linalg.cholesky(total * (covariance + covariance.T) / 2)
        return FullGaussian(mean, np.asarray(factor, dtype=np.float64))

    def divergence(self, weight: float) -> float:
        """Return KL(best || current) in nats, infinite if the objective is unbounded.

        The divergence decreases with `weight`.
        """
        best = self.best(weight)
        if best is None:
            return np.inf
        return best.divergence(FullGaussian(np.zeros_like(best.mean), np.eye(len(best.mean))))


SMALLEST_WEIGHT = 1e-12  # smallest weight of the divergence from the current distribution


def closed_form_update(
    current: FullGaussian,
    target: FullGaussian,
    contexts: Array,
    returns: Array,
    penalty: float,
    most_divergence: float,
) -> FullGaussian:
    """Return the update of `current` that maximises E[J] - penalty * KL(new || target).

    J is a quadratic model of the returns, and KL(new || current) is bounded. The best Gaussian has a closed
    form for every weight of that divergence; the smallest weight within the bound is found by bisection.

    Args:
        current: distribution of the contexts.
        target: target distribution.
        contexts: points (n, f).
        returns: returns (n,).
        penalty: weight of the divergence from the target, at least 0.
        most_divergence: bound of KL(new || current) in nats.
    """
    from scipy.optimize import bisect  # deferred, so that listing teachers does not import scipy

    with threadpool_limits(limits=1):  # for bitwise reproducibility
        gradient, curvature = quadratic_fit(current.whiten(contexts), returns)
        problem = ClosedForm(gradient, curvature, target.seen_from(current), penalty)
        weight = SMALLEST_WEIGHT
        if problem.divergence(weight) > most_divergence:
            high = 1.0
            while problem.divergence(high) > most_divergence:
                high *= 2
            ends = np.log(SMALLEST_WEIGHT), np.log(high)
            root = bisect(lambda log: problem.divergence(np.exp(log)) - most_divergence, *ends, xtol=1e-10)
            weight = min(high, float(np.exp(root)) * (1 + 1e-9))
        best = problem.best(weight)
        assert best is not None, "a step within the bound has a maximum"
        return best.placed_in(current)


LEAST_STD = 1e-3  # smallest standard deviation, as a share of the ranges; narrower samples cannot be fitted


def widened(gaussian: FullGaussian) -> FullGaussian:
    """Return `gaussian` with a standard deviation of at least `LEAST_STD` in every direction."""
    variances, axes = np.linalg.eigh(gaussian.factor @ gaussian.factor.T)
    if variances[0] >= LEAST_STD**2:
        return gaussian
    factor = np.linalg.cholesky((axes * np.maximum(variances, LEAST_STD**2)) @ axes.T)
    return FullGaussian(gaussian.mean, np.asarray(factor, dtype=np.float64))


@dataclass
class SPGL(SPDL):
    """SPDL with closed-form updates, based on a quadratic model of returns in place of state values.

    A Gaussian moves from an initial to a target distribution as returns rise.

    Sources: Ardakani and Song 2026 (arXiv:2603.23755) for the idea of closed-form updates of Gaussians; their
    formula could not be read. The one here is derived from the objective of Klink et al. 2020, with the
    divergence of a step measured as KL(new || old). All hyper-parameters are our choice.

    Attributes:
        first_update: environment steps before the first update.
        update_every: environment steps between two updates.
        updates_without_penalty: first updates with a penalty of 0.
        penalty_share: penalty as a share of the mean return.
        most_divergence: bound on KL(new || old) of an update, in nats.
        budget: environment steps of the run, to which `for_budget` fits first_update and update_every.
    """

    wants_values: ClassVar[bool] = False
    algorithm_version: ClassVar[int | None] = 1
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {}

    penalty_share: float = 0.25
    most_divergence: float = 0.2
    budget: int = PAPER_BUDGET

    def __post_init__(self) -> None:
        super().__post_init__()
        for_budget(self.update_every, self.budget)

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        """Start at the initial Gaussian."""
        super().start(space, knowledge, rng)
        self.tasks_: list[Task] = []
        self.returns_: list[float] = []
        self.next_update_ = for_budget(self.first_update, self.budget)

    def observe(self, episode: Episode) -> None:
        """Store the episode, and update the Gaussian when an update is due."""
        self.tasks_.append(episode.task)
        self.returns_.append(episode.episodic_return)
        if episode.step < self.next_update_:
            return
        every = for_budget(self.update_every, self.budget)
        self.next_update_ = next_due(self.next_update_, every, episode.step)
        old, contexts, returns = self.distribution_, np.stack(self.tasks_), np.array(self.returns_)
        penalty, bound = self._penalty(float(returns.mean())), self.most_divergence
        new = closed_form_update(old, self._target, self._box.normalise(contexts), returns, penalty, bound)
        self.distribution_ = widened(new)
        self.updates_ += 1
        step = self.distribution_.divergence(old)
        self._log({"alpha": penalty, "mean_return": float(returns.mean()), "step_divergence": step})
        self.tasks_, self.returns_ = [], []
