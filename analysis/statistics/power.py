"""Power of tests: the smallest difference that some seeds can show, and the seeds that one needs.

`first` and `second` have the n and the true standard deviations of two samples, whose means do not matter;
`significance` is the p under which a test finds a difference, and `wanted` the probability of finding it,
over `significance` and under 1. Differences are in the unit of the samples.
"""

import bisect
import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from analysis.statistics.samples import SIGNIFICANCE, TAIL, Description
from analysis.statistics.tests import Comparison, standard_error_of_difference

POWER = 0.8
"""Probability of finding a difference that is there, by convention (Cohen, 1988)."""

NODES = 64
"""Quadrature nodes for each sample variance: the power of two runs against two is exact to 1e-6."""

MOST_SEEDS = 1000
"""Seeds beyond which no number is looked for."""

FURTHEST = 1e6
"""Standard errors beyond which no difference is looked for."""


def power(
    difference: float, first: Description, second: Description, significance: float = SIGNIFICANCE
) -> float:
    """Return the probability that a two-sided Welch test finds `difference` between two means.

    Exact for normal samples: the noncentral t distribution holds where the degrees of freedom are known, as
    in Student's test, but Welch estimates them from the two sample variances, which costs much power
    with two or three seeds: with 3 seeds and a deviation of 10 it promises 0.8 for 30.7 points, which have
    0.70, and 35.1 are needed; from 10 seeds on both agree. Given both variances the test statistic is normal,
    so that the power is its mean over the distributions of both, by Gauss and Legendre's quadrature.

    Args:
        difference: difference of the true means.
        first: n and true standard deviation of a sample; its mean does not matter.
        second: the same of the other sample.
        significance: p under which the test finds a difference.

    Returns:
        NaN where a sample has fewer than two values or no standard deviation, or neither has a spread.
    """
    if not _testable(first, second):
        return math.nan
    error, _ = standard_error_of_difference(first, second)
    return _power(abs(difference) / error, first, second, significance)


def detectable_difference(
    first: Description, second: Description, wanted: float = POWER, significance: float = SIGNIFICANCE
) -> float:
    """Return the smallest difference of means that a two-sided Welch test finds with power `wanted`.

    Args:
        first: n and true standard deviation of a sample; its mean does not matter.
        second: the same of the other sample.
        wanted: probability of finding the difference, over `significance` and under 1.
        significance: p under which the test finds a difference.

    Returns:
        In the unit of the samples; NaN where `power` is NaN.

    Raises:
        ValueError: `wanted` is not between `significance` and 1.
    """
    if not significance < wanted < 1:
        raise ValueError(f"power {wanted}: expected over the significance, {significance}, and under 1")
    if not _testable(first, second):
        return math.nan
    error, _ = standard_error_of_difference(first, second)
    return _smallest_shift(lambda shift: _power(shift, first, second, significance), wanted) * error


def detectable_in_pairs(
    pairs: int, margin: float, wanted: float = POWER, significance: float = SIGNIFICANCE
) -> float:
    """Return the smallest mean difference that a two-sided paired t-test finds with power `wanted`.

    Exact for normal differences: the test statistic has the noncentral t distribution.

    Args:
        pairs: their number.
        margin: half the width of the 95 % interval of the mean difference.
        wanted: probability of finding the difference, over `significance` and under 1.
        significance: p under which the test finds a difference.

    Returns:
        In the unit of the margin; NaN with fewer than two pairs or without a margin over 0.
    """
    if pairs < 2 or not margin > 0:
        return math.nan
    from scipy import special

    shift = _smallest_shift(lambda shift: _student_power(shift, pairs - 1, significance), wanted)
    return shift * margin / float(special.stdtrit(pairs - 1, TAIL))


def _smallest_shift(power_at: Callable[[float], float], wanted: float) -> float:
    """Return the smallest difference in true standard errors with the power `wanted`."""
    from scipy import optimize  # half of the time that `import analysis` takes otherwise

    high = 1.0
    while power_at(high) < wanted and high < FURTHEST:
        high *= 2
    return float(optimize.brentq(lambda shift: power_at(shift) - wanted, 0.0, high))


def seeds_needed(test: Comparison, seeds: float, wanted: float = POWER) -> int | None:
    """Return the number of seeds that finds a difference as large as a test with fewer seeds saw.

    By the noncentral t distribution: the standard error of the difference falls with the root of the number
    of seeds, and the degrees of freedom grow with it.

    Args:
        test: a t-test, of pairs or of two samples, in one stratum or over several.
        seeds: number on each side in it; of two different numbers the harmonic mean.
        wanted: power of the test with the number that is returned.

    Returns:
        The least number, from 2 on; None without a t-test or where `MOST_SEEDS` do not suffice.
    """
    if seeds <= 1 or not math.isfinite(test.t):
        return None

    def suffices(number: int) -> bool:
        freedom = test.degrees_of_freedom * (number - 1) / (seeds - 1)
        return _student_power(abs(test.t) * math.sqrt(number / seeds), freedom, SIGNIFICANCE) >= wanted

    high = 2
    while not suffices(high):  # far beyond the number, the noncentral t distribution is not computed well
        high *= 2
        if high > 2 * MOST_SEEDS:
            return None
    found = bisect.bisect_left(range(high), True, lo=2, key=suffices)
    return found if found <= MOST_SEEDS else None


def _student_power(shift: float, freedom: float, significance: float) -> float:
    """Return the power of a two-sided t-test for a difference of `shift` true standard errors."""
    from scipy import special

    critical = float(special.stdtrit(freedom, 1 - significance / 2))
    low, high = special.nctdtr(freedom, shift, [-critical, critical])
    return float(1 - high + low)


def _power(shift: float, first: Description, second: Description, significance: float) -> float:
    from scipy import special

    error, _ = standard_error_of_difference(first, second)
    spreads = first.std / error, second.std / error
    critical, weights = _critical_values(first.n, spreads[0], second.n, spreads[1], significance)
    found = special.ndtr(shift - critical) + special.ndtr(-shift - critical)
    return float((weights * found).sum())


@lru_cache(maxsize=256)
def _critical_values(
    n: int, std: float, other_n: int, other_std: float, significance: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the differences (q, q) over which Welch finds one, by sample variances, and their weights."""
    from scipy import special

    (mine, weights), (theirs, other_weights) = _variances(n), _variances(other_n)
    first, second = (std**2 / n * mine)[:, None], (other_std**2 / other_n * theirs)[None, :]
    freedom = (first + second) ** 2 / (first**2 / (n - 1) + second**2 / (other_n - 1))
    critical = special.stdtrit(freedom, 1 - significance / 2) * np.sqrt(first + second)
    return np.asarray(critical, np.float64), weights[:, None] * other_weights[None, :]


@lru_cache(maxsize=256)
def _variances(n: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return values (q,) of the variance of n standard normal values, and their weights (q,)."""
    from scipy import special

    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    freedom = n - 1
    variances = np.asarray(special.chdtri(freedom, (1 - nodes) / 2) / freedom, np.float64)
    return variances, np.asarray(weights / 2, np.float64)


def _testable(first: Description, second: Description) -> bool:
    spreads = first.std, second.std
    return min(first.n, second.n) >= 2 and all(map(math.isfinite, spreads)) and max(spreads) > 0
