"""The widest distribution near the present one under which the student still succeeds often enough."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tma_ray.teachers.numerics.beta_product import BetaProduct

Array = NDArray[np.float64]

Valued = Callable[[Array], tuple[float, Array]]
"""Returns value and gradient (p,) at parameters (p,)."""

SLACK = 1e-4
"""By which a constraint may be missed, in nats or as a share: the solver's tolerance."""


@dataclass(frozen=True)
class EntropyUpdate:
    """The constrained problem of one update of DORAEMON.

    Attributes:
        present: the distribution that the points were drawn from.
        points: coordinates of the tasks played (n, f).
        successes: which of them the student mastered (n,).
        least_success: expected share of successes at least.
        most_divergence: bound on KL(present || new), in nats.
        largest: upper bound of the parameters; the lower one is 1.
    """

    present: BetaProduct
    points: Array
    successes: NDArray[np.bool_]
    least_success: float
    most_divergence: float
    largest: float

    def solved(self) -> BetaProduct:
        """Returns the feasible distribution of highest entropy; if there is none, that of most success."""
        start = self.present.logs
        if self.success(start)[0] < self.least_success:
            start = self._best(start, self.success, (), self.success(start)[0])
            if self.success(start)[0] < self.least_success:
                return BetaProduct.of_logs(start)
        constraint = self._shifted(self.success, -self.least_success)
        return BetaProduct.of_logs(self._best(start, self.entropy, (constraint,), self.entropy(start)[0]))

    def entropy(self, logs: Array) -> tuple[float, Array]:
        """Returns the entropy of the distribution with the parameters `logs`, and its gradient."""
        return BetaProduct.of_logs(logs).entropy()

    def success(self, logs: Array) -> tuple[float, Array]:
        """Returns the expected share of successes, by importance sampling, and its gradient."""
        old, _ = self.present.log_densities(self.points)
        new, gradients = BetaProduct.of_logs(logs).log_densities(self.points)
        weights = np.exp(new - old) * self.successes / len(self.points)
        return float(weights.sum()), weights @ gradients

    def room(self, logs: Array) -> tuple[float, Array]:
        """Returns how far the divergence is under its bound, and the gradient."""
        divergence, gradient = self.present.divergence(BetaProduct.of_logs(logs))
        return self.most_divergence - divergence, -gradient

    def _best(self, start: Array, goal: Valued, constraints: tuple[Valued, ...], least: float) -> Array:
        """Returns feasible parameters where `goal` is highest; `start` if it is nowhere over `least`."""
        from scipy.optimize import minimize  # imported here: drivers start sooner without it

        solve: Any = minimize  # whose stubs know fewer constraints than it takes
        all_constraints = (self.room, *constraints)
        result = solve(
            lambda logs: -goal(logs)[0],
            start,
            jac=lambda logs: -goal(logs)[1],
            method="SLSQP",
            bounds=[(0.0, np.log(self.largest))] * len(start),
            constraints=[_inequality(each) for each in all_constraints],
            options={"maxiter": 200, "ftol": 1e-12},
        )
        found: Array = result.x
        sound = np.isfinite(found).all() and all(each(found)[0] >= -SLACK for each in all_constraints)
        return found if sound and goal(found)[0] > least else start

    @staticmethod
    def _shifted(function: Valued, by: float) -> Valued:
        def shifted(logs: Array) -> tuple[float, Array]:
            value, gradient = function(logs)
            return value + by, gradient

        return shifted


def _inequality(function: Valued) -> dict[str, object]:
    """Returns the constraint that `function` is not negative, as scipy takes it."""
    return {"type": "ineq", "fun": lambda logs: function(logs)[0], "jac": lambda logs: function(logs)[1]}
