"""Power of t-tests, detectable differences and numbers of seeds."""

import bisect
import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from analysis.statistics.samples import SIGNIFICANCE, TAIL, Description
from analysis.statistics.tests import Comparison, standard_error_of_difference

POWER = 0.8
"""Conventional power (Cohen, 1988)."""

NODES = 64
"""Number of quadrature nodes per sample variance; the power of two runs against two is exact to 1e-6."""

MOST_SEEDS = 1000
"""Maximum number of seeds that `seeds_needed` returns."""

FURTHEST = 1e6
"""Largest difference that is searched, in standard errors."""


def power(
    difference: float, first: Description, second: Description, significance: float = SIGNIFICANCE
) -> float:
    """Return the power of a two-sided Welch test between two normal samples.

    The noncentral t distribution is exact for known degrees of freedom only. Welch's test estimates them from
    the sample variances, which costs much power with two or three seeds: with 3 seeds and a standard
    deviation of 10, the noncentral t has a power of 0.8 at 30.7 points, where the true power is 0.70. Given
    both variances the test statistic is normal, so its power is averaged over their distributions by
    Gauss-Legendre quadrature.

    Args:
        difference: difference of the true means.
        first: n and true standard deviation of a sample; the mean is ignored.
        second: n and true standard deviation of the other sample.
        significance: significance level.

    Returns:
        NaN where a sample has fewer than two values or no standard deviation, or neither has a spread.
    """
    if not _testable(first, second):
        return math.nan
    error, _ = standard_error_of_difference(first, second)
    return _power(abs(difference) / error, first, second, significance)


def detectable_difference(
    first: Description, second: Description, target: float = POWER, significance: float = SIGNIFICANCE
) -> float:
    """Return the smallest difference of means that a two-sided Welch test detects with a given power.

    Args:
        first: n and true standard deviation of a sample; the mean is ignored.
        second: n and true standard deviation of the other sample.
        target: power, above `significance` and below 1.
        significance: significance level.

    Returns:
        Difference in the unit of the samples; NaN where `power` is NaN.

    Raises:
        ValueError: if `target` is not between `significance` and 1.
    """
    if not significance < target < 1:
        raise ValueError(f"power {target}: expected over the significance, {significance}, and under 1")
    if not _testable(first, second):
        return math.nan
    error, _ = standard_error_of_difference(first, second)
    return _smallest_shift(lambda shift: _power(shift, first, second, significance), target) * error


def detectable_in_pairs(
    pairs: int, margin: float, target: float = POWER, significance: float = SIGNIFICANCE
) -> float:
    """Return the smallest mean difference that a two-sided paired t-test detects with a given power.

    Args:
        pairs: number of pairs.
        margin: half the width of the 95 % interval of the mean difference.
        target: power, above `significance` and below 1.
        significance: significance level.

    Returns:
        Difference in the unit of the margin; NaN with fewer than two pairs or without a margin above 0.
    """
    if pairs < 2 or not margin > 0:
        return math.nan
    from scipy import special

    shift = _smallest_shift(lambda shift: _student_power(shift, pairs - 1, significance), target)
    return shift * margin / float(special.stdtrit(pairs - 1, TAIL))


def _smallest_shift(power_at: Callable[[float], float], target: float) -> float:
    """Return the smallest difference that reaches the power `target`, in units of the true standard error."""
    from scipy import optimize  # deferred, as it would double the import time of `analysis`

    high = 1.0
    while power_at(high) < target and high < FURTHEST:
        high *= 2
    return float(optimize.brentq(lambda shift: power_at(shift) - target, 0.0, high))


def seeds_needed(test: Comparison, seeds: float, target: float = POWER) -> int | None:
    """Return the number of seeds with which a test would detect the observed difference.

    Args:
        test: t-test, of pairs or of two samples, in one stratum or over several.
        seeds: number of seeds on each side of the test, or their harmonic mean.
        target: power of the test with the returned number of seeds.

    Returns:
        The smallest number, at least 2; None without a t-test or where `MOST_SEEDS` do not suffice.
    """
    if seeds <= 1 or not math.isfinite(test.t):
        return None

    def suffices(number: int) -> bool:
        freedom = test.degrees_of_freedom * (number - 1) / (seeds - 1)
        return _student_power(abs(test.t) * math.sqrt(number / seeds), freedom, SIGNIFICANCE) >= target

    high = 2
    while not suffices(high):  # bracket from below, since the noncentral t is inaccurate far beyond the root
        high *= 2
        if high > 2 * MOST_SEEDS:
            return None
    least = bisect.bisect_left(range(high), True, lo=2, key=suffices)
    return least if least <= MOST_SEEDS else None


def _student_power(shift: float, freedom: float, significance: float) -> float:
    """Return the power of a two-sided t-test if the true difference is `shift` standard errors."""
    from scipy import special

    critical = float(special.stdtrit(freedom, 1 - significance / 2))
    low, high = special.nctdtr(freedom, shift, [-critical, critical])
    return float(1 - high + low)


def _power(shift: float, first: Description, second: Description, significance: float) -> float:
    from scipy import special

    error, _ = standard_error_of_difference(first, second)
    spreads = first.std / error, second.std / error
    critical, weights = _critical_values(first.n, spreads[0], second.n, spreads[1], significance)
    powers = special.ndtr(shift - critical) + special.ndtr(-shift - critical)
    return float((weights * powers).sum())


@lru_cache(maxsize=256)
def _critical_values(
    n: int, std: float, other_n: int, other_std: float, significance: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return Welch's critical differences (q, q) at pairs of sample variances, and the weights (q, q)."""
    from scipy import special

    (variances, weights), (other_variances, other_weights) = _variances(n), _variances(other_n)
    first = (std**2 / n * variances)[:, None]
    second = (other_std**2 / other_n * other_variances)[None, :]
    freedom = (first + second) ** 2 / (first**2 / (n - 1) + second**2 / (other_n - 1))
    critical = special.stdtrit(freedom, 1 - significance / 2) * np.sqrt(first + second)
    return np.asarray(critical, np.float64), weights[:, None] * other_weights[None, :]


@lru_cache(maxsize=256)
def _variances(n: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return quadrature nodes (q,) and weights (q,) for the sample variance of n standard normals."""
    from scipy import special

    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    freedom = n - 1
    variances = np.asarray(special.chdtri(freedom, (1 - nodes) / 2) / freedom, np.float64)
    return variances, np.asarray(weights / 2, np.float64)


def _testable(first: Description, second: Description) -> bool:
    spreads = first.std, second.std
    return min(first.n, second.n) >= 2 and all(map(math.isfinite, spreads)) and max(spreads) > 0
