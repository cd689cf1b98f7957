"""How large a difference must be before these many seeds can show it."""

from __future__ import annotations

import math

import numpy as np

from analysis.statistics import SIGNIFICANCE, Description, standard_error_of_difference

POWER = 0.8
"""Probability of finding a difference that is there, by convention (Cohen, 1988)."""

FURTHEST = 1e6
"""Standard errors beyond which no difference is looked for."""


def power(
    difference: float, first: Description, second: Description, significance: float = SIGNIFICANCE
) -> float:
    """Returns the probability that a two-sided Welch test finds `difference` between two means.

    From the noncentral t distribution with Welch and Satterthwaite's degrees of freedom; exact for
    normal samples of equal size and spread, close to it for others.

    Args:
        difference: of the true means.
        first: n and std of a sample; its mean does not matter.
        second: of the other.
        significance: p under which the test finds a difference.

    Returns:
        NaN where a sample has fewer than two values or no standard deviation, or neither has a spread.
    """
    if not _testable(first, second):
        return math.nan
    error, freedom = standard_error_of_difference(first, second)
    return _power(abs(difference) / error, freedom, significance)


def detectable_difference(
    first: Description, second: Description, wanted: float = POWER, significance: float = SIGNIFICANCE
) -> float:
    """Returns the smallest difference of means that a two-sided Welch test finds with power `wanted`.

    Args:
        first: n and std of a sample; its mean does not matter.
        second: of the other.
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
    from scipy import optimize  # as in `statistics`

    error, freedom = standard_error_of_difference(first, second)
    high = 1.0
    while _power(high, freedom, significance) < wanted and high < FURTHEST:
        high *= 2
    shift = optimize.brentq(lambda shift: _power(shift, freedom, significance) - wanted, 0.0, high)
    return float(shift) * error


def _power(shift: float, freedom: float, significance: float) -> float:
    """Returns the power for a difference of `shift` standard errors."""
    from scipy import special

    critical = special.stdtrit(freedom, 1 - significance / 2)
    # scipy has no number for tails that are too thin to count.
    missed, wrong_sign = np.nan_to_num(special.nctdtr(freedom, shift, np.array([critical, -critical])))
    return float(1 - missed + wrong_sign)


def _testable(first: Description, second: Description) -> bool:
    spreads = first.std, second.std
    return min(first.n, second.n) >= 2 and all(map(math.isfinite, spreads)) and max(spreads) > 0
