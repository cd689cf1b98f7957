"""DORAEMON, domain randomisation via entropy maximisation (Tiboni et al. 2024)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tma_ray.support.validation import check_at_least, check_positive, check_shares
from tma_ray.tasks import (
    Episode,
    ExpertKnowledge,
    KnowledgeLevel,
    Task,
    TaskSpace,
    TeacherUpdate,
    WeightedGaussian,
)
from tma_ray.teachers.base import PAPER_BUDGET, DistributionTeacher, for_budget, next_due
from tma_ray.teachers.numerics import CONSTANT_STD, Array, UnitBox

# smallest distance of points from the faces of the box, where densities are 0 or infinite
BOUNDARY_DISTANCE = 1e-6


class BetaProduct(NamedTuple):
    """Product of Beta distributions with parameters alpha (f,) and beta (f,)."""

    alpha: Array
    beta: Array

    @classmethod
    def around(cls, mode: Array, concentration: float) -> "BetaProduct":
        """Return the distribution with the given `mode` (f,) and `concentration`.

        At mode 1/2, both parameters are `concentration`.
        """
        weight = 2 * (concentration - 1)
        return cls(1 + weight * mode, 1 + weight * (1 - mode))

    @classmethod
    def of_logs(cls, logs: Array) -> "BetaProduct":
        """Return the distribution with the log parameters `logs` (2f,)."""
        return cls(*np.exp(logs).reshape(2, -1))

    @property
    def logs(self) -> Array:
        """Log parameters (2f,), those of alpha first."""
        return np.log(np.concatenate(self))

    @property
    def mean(self) -> Array:
        """Mean of each coordinate (f,)."""
        return self.alpha / (self.alpha + self.beta)

    @property
    def variance(self) -> Array:
        """Variance of each coordinate (f,)."""
        total = self.alpha + self.beta
        return self.alpha * self.beta / (total**2 * (total + 1))

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Draw `count` points (count, f), smooth in the parameters, by inverse transform sampling."""
        from scipy.special import betaincinv  # deferred, so that listing teachers does not import scipy

        shares = rng.random((count, len(self.alpha)))
        return np.asarray(betaincinv(self.alpha, self.beta, shares), dtype=np.float64)

    def entropy(self) -> tuple[float, Array]:
        """Return the differential entropy in nats, and its gradient with respect to `logs` (2f,)."""
        from scipy.special import betaln, polygamma, psi

        alpha, beta, total = self.alpha, self.beta, self.alpha + self.beta
        parts = (total - 2) * psi(total) - (alpha - 1) * psi(alpha) - (beta - 1) * psi(beta)
        common = (total - 2) * polygamma(1, total)
        by_alpha, by_beta = (common - (parameter - 1) * polygamma(1, parameter) for parameter in self)
        gradient = np.concatenate([alpha * by_alpha, beta * by_beta])
        return float((betaln(alpha, beta) + parts).sum()), gradient

    def divergence(self, other: "BetaProduct") -> tuple[float, Array]:
        """Return KL(self || other) in nats, and its gradient with respect to `other.logs` (2f,)."""
        from scipy.special import betaln, psi

        alpha, beta, total = self.alpha, self.beta, self.alpha + self.beta
        parts = betaln(*other) - betaln(alpha, beta)
        parts += (alpha - other.alpha) * psi(alpha) + (beta - other.beta) * psi(beta)
        parts += (other.alpha + other.beta - total) * psi(total)
        expected = np.stack([psi(alpha) - psi(total), psi(beta) - psi(total)])
        return float(parts.sum()), -(np.stack(other) * (expected - other._mean_logs())).ravel()

    def log_densities(self, points: Array) -> tuple[Array, Array]:
        """Return log densities (n,) at `points` (n, f), and gradients (n, 2f) with respect to `logs`."""
        from scipy.special import betaln

        inside = np.clip(points, BOUNDARY_DISTANCE, 1 - BOUNDARY_DISTANCE)
        sides = np.stack([np.log(inside), np.log1p(-inside)], axis=1)
        parameters = np.stack(self)
        values = ((parameters - 1) * sides).sum(axis=1) - betaln(self.alpha, self.beta)
        gradients = parameters * (sides - self._mean_logs())
        return values.sum(axis=1), gradients.reshape(len(points), -1)

    def _mean_logs(self) -> Array:
        """Return the expected values (2, f) of log x and log (1 - x)."""
        from scipy.special import psi

        means: Array = psi(np.stack(self)) - psi(self.alpha + self.beta)
        return means


Valued = Callable[[Array], tuple[float, Array]]  # maps log parameters (p,) to a value and its gradient (p,)
SLACK = 1e-4  # tolerance of the constraints, in nats (divergence) or as a share (successes)


@dataclass(frozen=True)
class EntropyUpdate:
    """Constrained optimisation problem that an update solves."""

    present: BetaProduct  # current distribution
    points: Array  # coordinates of the played tasks (n, f)
    successes: NDArray[np.bool_]  # True for tasks that the student mastered (n,)
    least_success: float  # lower bound on the expected share of successes
    most_divergence: float  # upper bound on KL(present || new), in nats
    largest: float  # upper bound of the parameters; the lower bound is 1

    def solved(self) -> BetaProduct:
        """Return the feasible distribution of highest entropy.

        If none is feasible, return the distribution of highest success within the bound on the divergence.
        """
        start = self.present.logs
        if self.success(start)[0] < self.least_success:
            start = self._best(start, self.success, (), self.success(start)[0])
            if self.success(start)[0] < self.least_success:
                return BetaProduct.of_logs(start)

        def enough(logs: Array) -> tuple[float, Array]:
            value, gradient = self.success(logs)
            return value - self.least_success, gradient

        return BetaProduct.of_logs(self._best(start, self.entropy, (enough,), self.entropy(start)[0]))

    def entropy(self, logs: Array) -> tuple[float, Array]:
        """Return the entropy of the distribution with the log parameters `logs`, and its gradient."""
        return BetaProduct.of_logs(logs).entropy()

    def success(self, logs: Array) -> tuple[float, Array]:
        """Return the expected success rate and its gradient, estimated by importance sampling."""
        old, _ = self.present.log_densities(self.points)
        new, gradients = BetaProduct.of_logs(logs).log_densities(self.points)
        weights = np.exp(new - old) * self.successes / len(self.points)
        return float(weights.sum()), weights @ gradients

    def room(self, logs: Array) -> tuple[float, Array]:
        """Return the slack of the bound on the divergence, and its gradient."""
        divergence, gradient = self.present.divergence(BetaProduct.of_logs(logs))
        return self.most_divergence - divergence, -gradient

    def _best(self, start: Array, goal: Valued, constraints: tuple[Valued, ...], least: float) -> Array:
        """Return the feasible parameters that maximise `goal`, or `start` if no value exceeds `least`."""
        from scipy.optimize import minimize

        solve: Any = minimize  # Any: scipy's type stubs lack these constraints
        all_constraints = (self.room, *constraints)
        result = solve(
            lambda logs: -goal(logs)[0],
            start,
            jac=lambda logs: -goal(logs)[1],
            method="SLSQP",
            bounds=[(0.0, np.log(self.largest))] * len(start),
            constraints=[
                {"type": "ineq", "fun": lambda x, of=of: of(x)[0], "jac": lambda x, of=of: of(x)[1]}
                for of in all_constraints
            ],
            options={"maxiter": 200, "ftol": 1e-12},
        )
        logs: Array = result.x
        sound = np.isfinite(logs).all() and all(value(logs)[0] >= -SLACK for value in all_constraints)
        return logs if sound and goal(logs)[0] > least else start


@dataclass
class DORAEMON(DistributionTeacher):
    """Teacher that samples independent Beta distributions, which widen while enough tasks are mastered.

    Every update maximises the entropy within a bound on the divergence from the old distribution, such that
    the expected share of mastered tasks, estimated by importance sampling from the episodes since the last
    update, is at least `least_success`. If that is impossible, it maximises the share. Nothing changes before
    the share is reached for the first time.

    Sources: Tiboni et al. 2024, section 4 and appendix; the authors' code.

    Attributes:
        least_success: smallest expected share of mastered tasks, in (0, 1) (paper: alpha).
        most_divergence: bound on KL(old || new) of an update, in nats (paper: epsilon).
        update_every: environment steps between two updates.
        concentration: initial value of both parameters of a Beta distribution with mode 1/2; the initial mode
            is the mean of the initial Gaussian.
        start_from_wide_uniform: True to start uniform, and narrow to mastered tasks, unless an easy task is
            known (authors' code).
        budget: environment steps of the run, to which `for_budget` fits update_every.
    """

    overlapping: ClassVar[bool] = True
    algorithm_version: ClassVar[int | None] = 1
    single_task: ClassVar[bool] = False
    knowledge_levels: ClassVar[tuple[KnowledgeLevel, ...]] = (KnowledgeLevel.LOW, KnowledgeLevel.HIGH)

    absent_at_default: ClassVar[frozenset[str]] = frozenset(("start_from_wide_uniform", "budget"))

    least_success: float = 0.5
    most_divergence: float = 0.05
    update_every: int = 100_000
    concentration: float = 100.0
    start_from_wide_uniform: bool = False
    budget: int = PAPER_BUDGET

    def __post_init__(self) -> None:
        check_shares(self, "least_success")
        check_positive(self, "least_success", "most_divergence")
        if self.least_success == 1:
            raise ValueError("least_success = 1: expected a share under 1")
        check_at_least(self, 1, "update_every")
        if not self.concentration > 1:
            raise ValueError(f"concentration = {self.concentration}: expected over 1, which is uniform")
        for_budget(self.update_every, self.budget)

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        """Start with a narrow or, if `start_from_wide_uniform` is True, a uniform distribution.

        The narrow one, always used at high knowledge, has its mode at the mean of the initial Gaussian.
        """
        super().start(space, knowledge, rng)
        self._box = UnitBox(space)
        mode = np.clip(self._box.normalise(knowledge.initial.mean), 0.0, 1.0)
        wide = self.start_from_wide_uniform and knowledge.level is not KnowledgeLevel.HIGH
        self.distribution_ = BetaProduct.around(mode, 1.0 if wide else self.concentration)
        self.tasks_: list[Task] = []
        self.successes_: list[bool] = []
        self.reached_ = wide
        self.next_update_ = for_budget(self.update_every, self.budget)
        self._log({})

    def draw(self, rng: np.random.Generator, count: int) -> Task:
        """Return `count` tasks (count, d) drawn from the current distribution."""
        return self._box.denormalise(self.distribution_.draw(rng, count))

    def observe(self, episode: Episode) -> None:
        """Store the episode, and update the distribution when an update is due."""
        self.tasks_.append(episode.task)
        self.successes_.append(episode.success)
        if episode.step < self.next_update_:
            return
        every = for_budget(self.update_every, self.budget)
        self.next_update_ = next_due(self.next_update_, every, episode.step)
        old, mastered = self.distribution_, np.array(self.successes_)
        self.reached_ = self.reached_ or bool(mastered.mean() >= self.least_success)
        if self.reached_:
            points = self._box.normalise(np.stack(self.tasks_))
            bounds = self.least_success, self.most_divergence, 2 * self.concentration
            self.distribution_ = EntropyUpdate(old, points, mastered, *bounds).solved()
        self.tasks_, self.successes_ = [], []
        step = old.divergence(self.distribution_)[0]
        self._log({"mastered_share": float(mastered.mean()), "step_divergence": step})

    def _log(self, scalars: dict[str, float]) -> None:
        """Log a Gaussian with the distribution's mean and variance, in task units."""
        free, scale = self._box.free, self.space.width[self._box.free]
        mean, variance = self.space.centre.copy(), np.full(self.space.size, CONSTANT_STD**2)
        mean[free] = self.space.low[free] + scale * self.distribution_.mean
        variance[free] = scale**2 * self.distribution_.variance
        gaussian = WeightedGaussian(1.0, mean, np.diag(variance))
        entropy = self.distribution_.entropy()[0]
        self.log(TeacherUpdate(gaussians=(gaussian,), scalars={**scalars, "entropy": entropy}))
