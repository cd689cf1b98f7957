"""Error-spending boundaries of group-sequential tests, and probabilities of crossing them.

Boundaries are one-sided, on the scale of standard normal test statistics: a boundary is crossed at the first
look whose statistic is over it. Statistics of looks have the canonical joint distribution (Jennison and
Turnbull, 2000, chapter 3): the correlation of two is the root of the ratio of their information.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, special

NODES, WEIGHTS = np.polynomial.legendre.leggauss(96)
"""Gauss-Legendre quadrature on [-1, 1], with which crossing probabilities are exact to 1e-9."""

LOWEST = -9.0  # point at which densities are truncated, in standard deviations from the mean
HIGHEST = 40.0  # upper end of the search for boundaries; beyond it, the tail is 0 in double precision
FURTHEST = 12.0  # search range around the naive estimate for the median-unbiased one, in standard errors

Floats = NDArray[np.float64]


def spent(fraction: float, error: float) -> float:
    """Return the part of the one-sided `error` that is spent up to a fraction of the information.

    Lan and DeMets' (1983) O'Brien-Fleming-type function: 2 - 2 Phi(z(1 - error / 2) / sqrt(fraction)).
    """
    return 2 * float(special.ndtr(special.ndtri(error / 2) / math.sqrt(fraction)))


@cache
def boundaries(
    fractions: tuple[float, ...], error: float, information: tuple[float, ...]
) -> tuple[float, ...]:
    """Return the boundary of each look, determined by the error-spending function `spent`.

    Args:
        fractions: planned information of each look as a share of the last one's, by which error is spent.
        error: one-sided error of all looks together.
        information: information of each look in any unit, which determines the correlations.
    """
    bounds: list[float] = []
    path, before = _Path(), 0.0
    for fraction, held in zip(fractions, information, strict=True):
        allowed = spent(fraction, error) - before
        bounds.append(
            float(optimize.brentq(lambda c: path.over(c, held) - allowed, LOWEST, HIGHEST, xtol=1e-10))  # noqa: B023
        )
        path, before = path.under(bounds[-1], held), before + allowed
    return tuple(bounds)


def crossing(bounds: Sequence[float], information: Sequence[float], drift: float = 0.0) -> list[float]:
    """Return the probability that each look is the first to cross its boundary.

    By recursive numerical integration (Armitage, McPherson and Rowe, 1969).

    Args:
        bounds: boundary of each look.
        information: information of each look, increasing, in any unit.
        drift: true difference, in the unit whose standard error at information i is 1 / sqrt(i).
    """
    path, probabilities = _Path(), []
    for bound, information_now in zip(bounds, information, strict=True):
        probabilities.append(path.over(bound, information_now, drift))
        path = path.under(bound, information_now, drift)
    return probabilities


def median_unbiased(statistic: float, bounds: Sequence[float], information: Sequence[float]) -> float:
    """Return the median-unbiased estimate of a difference after a sequential test has stopped.

    By the stagewise ordering of results (Jennison and Turnbull, 2000, section 8.4).

    Args:
        statistic: statistic of the look at which the test stopped.
        bounds: boundaries of the looks before it.
        information: information of each look until the stop, increasing.
    """
    naive = statistic / math.sqrt(information[-1])
    if not bounds:
        return naive
    if statistic < 0:
        return -median_unbiased(-statistic, bounds, information)
    reach = FURTHEST / math.sqrt(information[-1])

    def excess(drift: float) -> float:
        return sum(crossing([*bounds, statistic], information, drift)) - 0.5

    return float(optimize.brentq(excess, naive - reach, naive + reach, xtol=1e-9))


@dataclass(frozen=True)
class _Path:
    """Distribution of the scores S = Z sqrt(I) that have not crossed any boundary so far.

    Increments of scores are independent, N(drift dI, dI).
    """

    scores: Floats = field(default_factory=lambda: np.zeros(1))  # quadrature nodes (n,)
    density: Floats = field(default_factory=lambda: np.ones(1))  # probability at each node (n,)
    information: float = 0.0  # information at the latest look

    def over(self, bound: float, information: float, drift: float = 0.0) -> float:
        """Return the probability of crossing `bound` at the next look."""
        step = information - self.information
        distance = self.scores + drift * step - bound * math.sqrt(information)
        return float(self.density @ special.ndtr(distance / math.sqrt(step)))

    def under(self, bound: float, information: float, drift: float = 0.0) -> "_Path":
        """Return the distribution of the scores that do not cross `bound` at the next look."""
        step, root = information - self.information, math.sqrt(information)
        low, high = LOWEST + min(drift * root, bound), min(bound, drift * root - LOWEST)
        scores = root * ((high - low) / 2 * NODES + (high + low) / 2)
        far = (scores[:, None] - (self.scores + drift * step)[None, :]) / math.sqrt(step)
        moved = np.exp(-(far**2) / 2) @ self.density / math.sqrt(2 * math.pi * step)
        return _Path(scores, WEIGHTS * root * (high - low) / 2 * moved, information)
