"""Gaussians with full covariance, their divergences, and how they look from each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FullGaussian:
    """A Gaussian with full covariance.

    Attributes:
        mean: (d,).
        factor: Cholesky factor (d, d) of the covariance, lower triangular with a positive diagonal.
    """

    mean: Array
    factor: Array

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Returns `count` points (count, d)."""
        return self.mean + rng.standard_normal((count, self.mean.size)) @ self.factor.T

    def divergence(self, other: FullGaussian) -> float:
        """Returns the Kullback-Leibler divergence KL(self || other), in nats."""
        seen = self.seen_from(other)
        squares = (seen.factor**2).sum() + (seen.mean**2).sum() - seen.mean.size
        return float(squares / 2 - np.log(np.diag(seen.factor)).sum())

    def log_ratio(self, points: Array) -> Array:
        """Returns log density (n,) at `points` (n, d), minus that of the standard Gaussian."""
        gained = (points**2).sum(axis=1) - (self.whiten(points) ** 2).sum(axis=1)
        ratio: Array = gained / 2 - np.log(np.diag(self.factor)).sum()
        return ratio

    def whiten(self, points: Array) -> Array:
        """Returns `points` (n, d) in coordinates in which this is the standard Gaussian."""
        whitened: Array = solve_triangular(self.factor, (points - self.mean).T, lower=True).T
        return whitened

    def seen_from(self, frame: FullGaussian) -> FullGaussian:
        """Returns this Gaussian in coordinates in which `frame` is the standard one."""
        factor: Array = solve_triangular(frame.factor, self.factor, lower=True)
        return FullGaussian(frame.whiten(self.mean[None])[0], factor)

    def placed_in(self, frame: FullGaussian) -> FullGaussian:
        """Returns the Gaussian that looks like this one from `frame`: the inverse of `seen_from`."""
        return FullGaussian(frame.mean + frame.factor @ self.mean, frame.factor @ self.factor)
