"""SPDL, self-paced deep reinforcement learning (Klink et al. 2020)."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import brentq, minimize_scalar
from threadpoolctl import threadpool_limits

from tma_ray.support.validation import check_at_least, check_positive
from tma_ray.tasks import (
    Episode,
    ExpertKnowledge,
    Gaussian,
    KnowledgeLevel,
    Query,
    QueryKind,
    Task,
    TaskSpace,
    TeacherUpdate,
    WeightedGaussian,
)
from tma_ray.teachers.base import DistributionTeacher, next_due
from tma_ray.teachers.numerics import Array, UnitBox


@dataclass(frozen=True, eq=False)
class FullGaussian:
    """Gaussian, stored as its mean (d,) and the lower Cholesky factor (d, d) of its covariance."""

    mean: Array
    factor: Array

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Draw `count` points (count, d)."""
        return self.mean + rng.standard_normal((count, self.mean.size)) @ self.factor.T

    def divergence(self, other: "FullGaussian") -> float:
        """Return the Kullback-Leibler divergence KL(self || other), in nats."""
        seen = self.seen_from(other)
        squares = (seen.factor**2).sum() + (seen.mean**2).sum() - seen.mean.size
        return float(squares / 2 - np.log(np.diag(seen.factor)).sum())

    def log_ratio(self, points: Array) -> Array:
        """Return the log density ratio (n,) of this to the standard Gaussian at `points` (n, d)."""
        gained = (points**2).sum(axis=1) - (self.whiten(points) ** 2).sum(axis=1)
        ratio: Array = gained / 2 - np.log(np.diag(self.factor)).sum()
        return ratio

    def whiten(self, points: Array) -> Array:
        """Transform `points` (n, d) to coordinates in which this Gaussian is the standard one."""
        whitened: Array = solve_triangular(self.factor, (points - self.mean).T, lower=True).T
        return whitened

    def seen_from(self, frame: "FullGaussian") -> "FullGaussian":
        """Transform this Gaussian to coordinates in which `frame` is the standard Gaussian."""
        factor: Array = solve_triangular(frame.factor, self.factor, lower=True)
        return FullGaussian(frame.whiten(self.mean[None])[0], factor)

    def placed_in(self, frame: "FullGaussian") -> "FullGaussian":
        """Transform this Gaussian back from the coordinates of `frame`; inverse of `seen_from`."""
        return FullGaussian(frame.mean + frame.factor @ self.mean, frame.factor @ self.factor)


LARGEST_LOG_WEIGHT = 50.0  # bound on log importance weights, to keep the objective finite
SMALLEST_GRADIENT = 1e-10  # smallest gradient norm that leads to an update (original release)


def self_paced_update(
    current: FullGaussian,
    target: FullGaussian,
    contexts: Array,
    values: Array,
    penalty: float,
    most_divergence: float,
) -> FullGaussian:
    """Return the update of `current` that maximises E[V] - penalty * KL(new || target).

    The update is a line search along the natural gradient, within a bound on KL(current || new). The
    expectation is estimated by importance weights.

    Sources: Klink et al. 2020, algorithm 1. The original release takes the same direction, up to 1.5 times
    the bound. Unlike in that release, the mean of the values is subtracted before weighting: this changes no
    expectation, but otherwise the noise of the sum of weights outweighs the penalty, and flat values keep the
    distribution away from its target.

    Args:
        current: distribution of the contexts.
        target: target distribution.
        contexts: points (n, d).
        values: values V of the student in these contexts (n,).
        penalty: weight of the divergence from the target, at least 0 (paper: alpha).
        most_divergence: bound of the step in nats (paper: epsilon).
    """
    with threadpool_limits(limits=1):  # for bitwise reproducibility
        # in coordinates in which the current distribution is the standard Gaussian
        points, gains, seen = current.whiten(contexts), values - values.mean(), target.seen_from(current)
        shift, spread = _natural_gradient(points, gains, seen, penalty)
        if not (shift.any() or spread.any()):
            return current

        def moved(distance: float) -> FullGaussian:
            factor = np.tril(distance * spread, -1)
            np.fill_diagonal(factor, np.exp(distance * np.diag(spread)))
            return FullGaussian(distance * shift, factor)

        standard = moved(0.0)

        def excess(distance: float) -> float:
            return standard.divergence(moved(distance)) - most_divergence

        def loss(distance: float) -> float:
            new = moved(distance)
            weights = np.exp(np.minimum(new.log_ratio(points), LARGEST_LOG_WEIGHT))
            return -(float(np.mean(weights * gains)) - penalty * new.divergence(seen))

        far = 1e-3
        while excess(far) < 0:
            far *= 2
        reach = float(brentq(excess, 0.0, far)) * (1 - 1e-9)  # to stay within the bound despite rounding
        within = float(minimize_scalar(loss, bounds=(0.0, reach), method="bounded").x)
        return moved(min((0.0, within, reach), key=loss)).placed_in(current)


def _natural_gradient(
    points: Array, gains: Array, target: FullGaussian, penalty: float
) -> tuple[Array, Array]:
    """Return the normalised natural gradient at the standard Gaussian, or zeros if it vanishes.

    It has unit length, and consists of a shift of the mean (d,) and a change of the factor (d, d), with
    logarithms on its diagonal. The Fisher information is 2 for these, and 1 for all other entries.
    """
    count, size = points.shape
    inverse = solve_triangular(target.factor, np.eye(size), lower=True)
    precision = inverse.T @ inverse
    shift = gains @ points / count + penalty * precision @ target.mean
    moments = (points.T * gains) @ points / count
    slope = np.tril(moments + penalty * (np.eye(size) - precision))
    if np.sqrt((shift**2).sum() + (slope**2).sum()) < SMALLEST_GRADIENT:
        return np.zeros(size), np.zeros((size, size))
    spread = slope - np.diag(np.diag(slope)) / 2
    length = np.sqrt((shift**2).sum() + (spread**2).sum())
    return shift / length, spread / length


MOST_CONTEXTS = 1000  # largest number of episodes in an update (original release; not given in the paper)
LARGEST_PENALTY = 1e5  # upper bound of alpha, reached near the target distribution (original release)


@dataclass
class SPDL(DistributionTeacher):
    """Teacher that samples a Gaussian, which moves to a target distribution as the state values rise.

    Every update maximises the mean value of the tasks' initial states minus a penalty for the divergence from
    the target, within a bound on the divergence from the old Gaussian. The weight alpha of the penalty is
    chosen such that it is a constant share of the mean discounted return.

    Sources: Klink et al. 2020, algorithm 1; paper, appendix A (Self-Paced), appendix C (expert knowledge) and
    table of hyper-parameters. An update happens at the first end of an episode after it is due; in the
    original release, on that step within an episode.

    The preset "release" has the values of the original release's launch files: twice as many updates, each
    within an eighth of the divergence, and five times the penalty, from the eleventh update on.

    Attributes:
        first_update: environment steps before the first update (paper: n_OFFSET).
        update_every: environment steps between two updates (paper: n_STEP).
        updates_without_penalty: first updates with alpha = 0 (paper: K_alpha).
        penalty_share: penalty as a share of the mean discounted return (paper: zeta).
        most_divergence: bound on KL(old || new) of an update, in nats (paper: epsilon).
    """

    wants_values: ClassVar[bool] = True
    overlapping: ClassVar[bool] = True
    algorithm_version: ClassVar[int | None] = 1
    single_task: ClassVar[bool] = False
    knowledge_levels: ClassVar[tuple[KnowledgeLevel, ...]] = (KnowledgeLevel.NONE, KnowledgeLevel.HIGH)
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "release": {
            "update_every": 50_000,
            "updates_without_penalty": 10,
            "penalty_share": 0.25,
            "most_divergence": 0.1,
        }
    }

    first_update: int = 200_000
    update_every: int = 100_000
    updates_without_penalty: int = 0
    penalty_share: float = 0.05
    most_divergence: float = 0.8

    def __post_init__(self) -> None:
        check_at_least(self, 0, "first_update", "updates_without_penalty", "penalty_share")
        check_at_least(self, 1, "update_every")
        check_positive(self, "most_divergence")

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        """Start at the initial Gaussian."""
        super().start(space, knowledge, rng)
        self._box = UnitBox(space)
        self._target = self._scaled(knowledge.target)
        self.distribution_ = self._scaled(knowledge.initial)
        self.contexts_: deque[tuple[Task, NDArray[np.float32]]] = deque(maxlen=MOST_CONTEXTS)
        self.discounted_returns_: list[float] = []
        self.updates_ = 0
        self.next_update_ = self.first_update
        self._log({})

    def draw(self, rng: np.random.Generator, count: int) -> Task:
        """Return `count` tasks (count, d) drawn from the current Gaussian, clipped to the space."""
        return self._box.denormalise(self.distribution_.draw(rng, count))

    def observe(self, episode: Episode) -> Query | None:
        """Store the episode, and request the values of all initial states when an update is due."""
        self.contexts_.append((episode.task, episode.initial_observation))
        self.discounted_returns_.append(episode.discounted_return)
        if episode.step < self.next_update_:
            return None
        self.next_update_ = next_due(self.first_update, self.update_every, episode.step)
        return Query(QueryKind.STATE_VALUES, np.stack([observation for _, observation in self.contexts_]))

    def answer(self, answer: Array) -> None:
        """Update the Gaussian with the values (n,) of the stored episodes' initial states."""
        old, performance = self.distribution_, float(np.mean(self.discounted_returns_))
        penalty = self._penalty(performance)
        contexts = self._box.normalise(np.stack([task for task, _ in self.contexts_]))
        bound = self.most_divergence
        self.distribution_ = self_paced_update(old, self._target, contexts, answer, penalty, bound)
        self.updates_ += 1
        self.contexts_.clear()
        self.discounted_returns_.clear()
        self._log(
            {
                "alpha": penalty,
                "mean_value": float(answer.mean()),
                "mean_discounted_return": performance,
                "step_divergence": old.divergence(self.distribution_),
            }
        )

    def _penalty(self, performance: float) -> float:
        share = self.penalty_share * performance
        if self.updates_ < self.updates_without_penalty or share <= 0:
            return 0.0
        return share / max(self.distribution_.divergence(self._target), share / LARGEST_PENALTY)

    def _scaled(self, gaussian: Gaussian) -> FullGaussian:
        width = self.space.width[self._box.free]
        deviations = np.sqrt(gaussian.variance[self._box.free]) / width
        return FullGaussian(self._box.normalise(gaussian.mean), np.diag(deviations))

    def _log(self, scalars: dict[str, float]) -> None:
        """Log the Gaussian in task units; constant dimensions keep the initial Gaussian's values."""
        free, initial = self._box.free, self.knowledge.initial
        scale = self.space.width[free]
        mean, covariance = initial.mean.copy(), np.diag(initial.variance)
        mean[free] = self.space.low[free] + scale * self.distribution_.mean
        factor = scale[:, None] * self.distribution_.factor
        covariance[np.ix_(free, free)] = factor @ factor.T
        scalars = {**scalars, "target_divergence": self.distribution_.divergence(self._target)}
        self.log(TeacherUpdate(gaussians=(WeightedGaussian(1.0, mean, covariance),), scalars=scalars))
