"""Independent Beta distributions over the unit box: entropy, divergence and their gradients."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MARGIN = 1e-6
"""Points nearer to the boundary of the box count as this far from it: densities there are 0 or infinite."""


class BetaProduct(NamedTuple):
    """One Beta distribution for each of f coordinates.

    Attributes:
        alpha: first parameters (f,).
        beta: second parameters (f,).
    """

    alpha: Array
    beta: Array

    @classmethod
    def around(cls, mode: Array, concentration: float) -> BetaProduct:
        """Returns the distribution with a `mode` (f,), in the middle with both parameters `concentration`."""
        weight = 2 * (concentration - 1)
        return cls(1 + weight * mode, 1 + weight * (1 - mode))

    @classmethod
    def of_logs(cls, logs: Array) -> BetaProduct:
        """Returns the distribution whose parameters have the logarithms (2f,)."""
        return cls(*np.exp(logs).reshape(2, -1))

    @property
    def logs(self) -> Array:
        """Logarithms of all parameters (2f,)."""
        return np.log(np.concatenate(self))

    @property
    def mean(self) -> Array:
        """Means (f,)."""
        return self.alpha / (self.alpha + self.beta)

    @property
    def variance(self) -> Array:
        """Variances (f,)."""
        total = self.alpha + self.beta
        return self.alpha * self.beta / (total**2 * (total + 1))

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Returns `count` points (count, f), which depend smoothly on the parameters: nothing is rejected."""
        from scipy.special import betaincinv  # imported here: drivers start sooner without it

        shares = rng.random((count, len(self.alpha)))
        return np.asarray(betaincinv(self.alpha, self.beta, shares), dtype=np.float64)

    def entropy(self) -> tuple[float, Array]:
        """Returns the differential entropy in nats, at most 0, and its gradient by `logs` (2f,)."""
        from scipy.special import betaln, polygamma, psi

        alpha, beta, total = self.alpha, self.beta, self.alpha + self.beta
        parts = (total - 2) * psi(total) - (alpha - 1) * psi(alpha) - (beta - 1) * psi(beta)
        common = (total - 2) * polygamma(1, total)
        by_alpha, by_beta = (common - (each - 1) * polygamma(1, each) for each in self)
        gradient = np.concatenate([alpha * by_alpha, beta * by_beta])
        return float((betaln(alpha, beta) + parts).sum()), gradient

    def divergence(self, other: BetaProduct) -> tuple[float, Array]:
        """Returns KL(self || other) in nats, and its gradient by the logs of `other` (2f,)."""
        from scipy.special import betaln, psi

        alpha, beta, total = self.alpha, self.beta, self.alpha + self.beta
        parts = betaln(*other) - betaln(alpha, beta)
        parts += (alpha - other.alpha) * psi(alpha) + (beta - other.beta) * psi(beta)
        parts += (other.alpha + other.beta - total) * psi(total)
        expected = np.stack([psi(alpha) - psi(total), psi(beta) - psi(total)])
        return float(parts.sum()), -(np.stack(other) * (expected - other._mean_logs())).ravel()

    def log_densities(self, points: Array) -> tuple[Array, Array]:
        """Returns the log densities (n,) of `points` (n, f), and their gradients by `logs` (n, 2f)."""
        from scipy.special import betaln

        inside = np.clip(points, MARGIN, 1 - MARGIN)
        sides = np.stack([np.log(inside), np.log1p(-inside)], axis=1)
        parameters = np.stack(self)
        values = ((parameters - 1) * sides).sum(axis=1) - betaln(self.alpha, self.beta)
        gradients = parameters * (sides - self._mean_logs())
        return values.sum(axis=1), gradients.reshape(len(points), -1)

    def _mean_logs(self) -> Array:
        """Returns the expectations (2, f) of log x and log (1 - x)."""
        from scipy.special import psi

        means: Array = psi(np.stack(self)) - psi(self.alpha + self.beta)
        return means
