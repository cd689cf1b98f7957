"""Means over seeds and Welch's t-test between two samples of seeds."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

CONFIDENCE = 0.95
"""Coverage of the confidence intervals."""

SIGNIFICANCE = 0.05
"""Two samples differ significantly when p is strictly under this (paper, appendix on results)."""


@dataclass(frozen=True)
class Description:
    """A sample in four numbers; NaN where the sample is too small for one.

    Attributes:
        n: finite values in the sample.
        mean: arithmetic mean.
        std: standard deviation with n - 1 degrees of freedom; needs two values.
    """

    n: int
    mean: float
    std: float

    @property
    def standard_error(self) -> float:
        """Standard error of the mean, std / sqrt(n)."""
        return self.std / math.sqrt(self.n) if self.n else math.nan


def describe(values: ArrayLike) -> Description:
    """Returns n, mean, standard deviation and standard error of the finite ones among `values`."""
    sample = _finite(values)
    mean = float(sample.mean()) if sample.size else math.nan
    std = float(sample.std(ddof=1)) if sample.size > 1 else math.nan
    return Description(sample.size, mean, std)


def mean_interval(sample: Description) -> tuple[float, float]:
    """Returns the 95 % confidence interval of the mean, by Student's t; NaN under two values."""
    if sample.n < 2:
        return math.nan, math.nan
    from scipy import stats  # as in `welch_from_statistics`

    margin = float(stats.t.ppf((1 + CONFIDENCE) / 2, sample.n - 1)) * sample.standard_error
    return sample.mean - margin, sample.mean + margin


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


def holm(p_values: ArrayLike) -> NDArray[np.float64]:
    """Returns Holm's adjustment of `p_values` (n,) for testing n hypotheses at once; NaN stays NaN."""
    values = np.asarray(p_values, dtype=np.float64)
    adjusted = np.full(values.shape, np.nan)
    order = np.argsort(values)[: np.isfinite(values).sum()]  # NaN sorts last
    steps = values[order] * np.arange(order.size, 0, -1)
    adjusted[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return adjusted


def _obstacle(first: Description, second: Description) -> str:
    if min(first.n, second.n) < 2:
        return "needs 2 seeds"
    if not (math.isfinite(first.std) and math.isfinite(second.std)):
        return "no standard deviation"
    if first.std == 0 and second.std == 0:
        return "no spread between seeds"
    return ""


def _finite(values: ArrayLike) -> NDArray[np.float64]:
    array = np.asarray(values, dtype=np.float64)
    return array[np.isfinite(array)]
