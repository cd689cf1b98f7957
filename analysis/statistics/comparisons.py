"""Welch's t-test between two samples of runs, or between published means and deviations."""

from __future__ import annotations

import math
from dataclasses import dataclass

import pandas as pd

from analysis.statistics.samples import CONFIDENCE, SIGNIFICANCE, Description, describe


@dataclass(frozen=True)
class Comparison:
    """Welch's t-test of a sample against a reference; NaN where there is no test.

    Attributes:
        n: values in the sample.
        reference_n: values in the reference.
        difference: mean of the sample minus mean of the reference.
        low: lower end of the 95 % confidence interval of `difference`.
        high: upper end of it.
        t: test statistic.
        degrees_of_freedom: Welch and Satterthwaite's, seldom whole.
        p: two-sided p-value.
        reason: why there is no test; empty when there is one.
    """

    n: int
    reference_n: int
    difference: float
    low: float = math.nan
    high: float = math.nan
    t: float = math.nan
    degrees_of_freedom: float = math.nan
    p: float = math.nan
    reason: str = ""

    @property
    def significant(self) -> bool:
        """Whether there is a test and its p-value is under 0.05."""
        return self.p < SIGNIFICANCE


def welch(sample: pd.Series, reference: pd.Series) -> Comparison:
    """Compares the means of two independent samples without assuming equal variances.

    Args:
        sample: one value per run, indexed by run id.
        reference: likewise; two samples that have a run in common are not independent and get no
            test, so that cells which share their runs are never compared with themselves.
    """
    first, second = describe(sample), describe(reference)
    if set(sample.index) & set(reference.index):
        return Comparison(first.n, second.n, first.mean - second.mean, reason="same runs")
    return welch_from_statistics(first, second)


def welch_from_statistics(first: Description, second: Description) -> Comparison:
    """Compares the means of two independent samples of which only n, mean and std are known.

    Args:
        first: the sample, as in a published table.
        second: the reference.
    """
    difference = first.mean - second.mean
    reason = _obstacle(first, second)
    if reason:
        return Comparison(first.n, second.n, difference, reason=reason)
    from scipy import stats  # half of the time that `import analysis` takes otherwise

    error, freedom = standard_error_of_difference(first, second)
    t = difference / error
    margin = float(stats.t.ppf((1 + CONFIDENCE) / 2, freedom)) * error
    return Comparison(
        n=first.n,
        reference_n=second.n,
        difference=difference,
        low=difference - margin,
        high=difference + margin,
        t=t,
        degrees_of_freedom=freedom,
        p=2 * float(stats.t.sf(abs(t), freedom)),
    )


def standard_error_of_difference(first: Description, second: Description) -> tuple[float, float]:
    """Returns the standard error of the difference of two means, and Welch and Satterthwaite's freedom.

    Both samples need two values, and one of them a spread.
    """
    variances = first.standard_error**2, second.standard_error**2
    parts = (variance**2 / (n - 1) for variance, n in zip(variances, (first.n, second.n), strict=True))
    return math.sqrt(sum(variances)), sum(variances) ** 2 / sum(parts)


def _obstacle(first: Description, second: Description) -> str:
    if min(first.n, second.n) < 2:
        return "needs 2 seeds"
    if not (math.isfinite(first.std) and math.isfinite(second.std)):
        return "no standard deviation"
    if first.std == 0 and second.std == 0:
        return "no spread between seeds"
    return ""
