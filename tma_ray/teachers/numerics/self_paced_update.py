"""The update of a self-paced task distribution: better values, nearer to the target, not too far at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import brentq, minimize_scalar
from threadpoolctl import threadpool_limits

from tma_ray.teachers.numerics.full_gaussian import FullGaussian

Array = NDArray[np.float64]

LARGEST_LOG_WEIGHT = 50.0
"""Cap of log importance weights: keeps every objective finite, far over any that could be estimated."""

SMALLEST_GRADIENT = 1e-10
"""With a shorter one there is nothing to gain (as in the original release)."""


def self_paced_update(
    current: FullGaussian,
    target: FullGaussian,
    contexts: Array,
    values: Array,
    penalty: float,
    most_divergence: float,
) -> FullGaussian:
    """Returns a distribution that improves E[V] - penalty * KL(new || target).

    It lies in the direction of the natural gradient, where the objective is largest without
    KL(current || new) over `most_divergence`. The expectation is estimated by importance weights.

    Sources: Klink et al. 2020, algorithm 1. The original release goes the same way, as far as 1.5
    times the bound. Differently from it, the mean of the values is subtracted before they are
    weighted: that changes no expectation, but without it the noise of the weights' own sum outweighs
    the penalty, and flat values keep the distribution away from its target.

    Args:
        current: the distribution that the contexts were drawn from.
        target: where the penalty pulls to.
        contexts: points (n, d).
        values: V of the student in them (n,).
        penalty: weight of the divergence from the target, at least 0 (paper: alpha).
        most_divergence: bound of the step in nats (paper: epsilon).
    """
    with threadpool_limits(limits=1):  # so that where a teacher runs does not change what it finds
        problem = _Problem(
            points=current.whiten(contexts),
            gains=values - values.mean(),
            target=target.seen_from(current),
            penalty=penalty,
        )
        ray = problem.natural_gradient()
        if ray is None:
            return current
        reach = ray.reach(most_divergence)

        def loss(distance: float) -> float:
            return -problem.objective(ray.at(distance))

        within = float(minimize_scalar(loss, bounds=(0.0, reach), method="bounded").x)
        return ray.at(min((0.0, within, reach), key=loss)).placed_in(current)


@dataclass(frozen=True, eq=False)
class _Ray:
    """Distributions in one direction from the standard Gaussian, all of them valid.

    Attributes:
        shift: of the mean (d,).
        spread: lower triangle (d, d) of the factor's change; its diagonal is that of the logarithms.
    """

    shift: Array
    spread: Array

    def at(self, distance: float) -> FullGaussian:
        factor = np.tril(distance * self.spread, -1)
        np.fill_diagonal(factor, np.exp(distance * np.diag(self.spread)))
        return FullGaussian(distance * self.shift, factor)

    def reach(self, most_divergence: float) -> float:
        """Returns the distance just before KL(standard || new) attains `most_divergence`."""
        standard = self.at(0.0)

        def excess(distance: float) -> float:
            return standard.divergence(self.at(distance)) - most_divergence

        far = 1e-3
        while excess(far) < 0:
            far *= 2
        return float(brentq(excess, 0.0, far)) * (1 - 1e-9)


@dataclass(frozen=True, eq=False)
class _Problem:
    """Objective to maximise, in coordinates in which the current distribution is the standard Gaussian.

    Attributes:
        points: contexts (n, d).
        gains: their values (n,), over the mean value.
        target: where the penalty pulls to.
        penalty: its weight.
    """

    points: Array
    gains: Array
    target: FullGaussian
    penalty: float

    def objective(self, new: FullGaussian) -> float:
        weights = np.exp(np.minimum(new.log_ratio(self.points), LARGEST_LOG_WEIGHT))
        return float(np.mean(weights * self.gains)) - self.penalty * new.divergence(self.target)

    def natural_gradient(self) -> _Ray | None:
        """Returns the steepest direction per divergence at the standard Gaussian; None without a slope.

        There the Fisher information is 1 for mean and off-diagonal entries of the factor, and 2 for
        the logarithms of its diagonal.
        """
        count, size = self.points.shape
        inverse = solve_triangular(self.target.factor, np.eye(size), lower=True)
        precision = inverse.T @ inverse
        shift = self.gains @ self.points / count + self.penalty * precision @ self.target.mean
        moments = (self.points.T * self.gains) @ self.points / count
        slope = np.tril(moments + self.penalty * (np.eye(size) - precision))
        if np.sqrt((shift**2).sum() + (slope**2).sum()) < SMALLEST_GRADIENT:
            return None
        spread = slope - np.diag(np.diag(slope)) / 2
        length = np.sqrt((shift**2).sum() + (spread**2).sum())
        return _Ray(shift / length, spread / length)
