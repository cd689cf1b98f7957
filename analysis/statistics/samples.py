"""Descriptive statistics, confidence intervals, Holm's correction, and equivalence within a margin."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

CONFIDENCE = 0.95  # coverage probability of confidence intervals
TAIL = (1 + CONFIDENCE) / 2  # probability below an interval's upper end

SIGNIFICANCE = 0.05
"""Significance level; p-values strictly below it are significant (paper, appendix on results)."""

EQUAL = 1e-9  # relative tolerance below which differences and deviations are rounding errors


def negligible(deviations: ArrayLike, values: ArrayLike) -> NDArray[np.bool_]:
    """Return a mask of the deviations so small relative to `values` that they are rounding errors.

    This is the only criterion for samples without spread and for equal means.

    Args:
        deviations: differences or standard deviations of any shape.
        values: values such as means, of a shape that broadcasts; nothing is negligible relative to NaN.
    """
    return np.asarray(np.abs(deviations) <= EQUAL * np.abs(values))


def deviations(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the deviations of values (..., n) from their means (...), with rounding errors set to 0."""
    means = values.mean(axis=-1, keepdims=True)
    differences = values - means
    return np.where(negligible(differences, means), 0.0, differences)


@dataclass(frozen=True)
class Description:
    """Size, mean and standard deviation of a sample; NaN where the sample is too small.

    Attributes:
        n: number of finite values.
        mean: arithmetic mean.
        std: standard deviation with n - 1 degrees of freedom; 0 in place of a rounding error of the mean.
    """

    n: int
    mean: float
    std: float

    def __post_init__(self) -> None:
        if self.n < 0 or self.std < 0:
            raise ValueError(f"{self}: expected a number of values and a deviation of at least 0")
        if negligible(self.std, self.mean):
            object.__setattr__(self, "std", 0.0)

    @property
    def standard_error(self) -> float:
        """Standard error of the mean, std / sqrt(n)."""
        return self.std / math.sqrt(self.n) if self.n else math.nan


@dataclass(frozen=True)
class Estimate:
    """Point estimate with its 95 % confidence interval, NaN for missing values.

    Attributes:
        value: point estimate.
        low: lower end of the interval.
        high: upper end of the interval.
        n: number of runs, over both samples in a comparison.
        reason: reason why there is no interval; empty if there is one.
    """

    value: float
    low: float
    high: float
    n: int
    reason: str = ""


def describe(values: ArrayLike) -> Description:
    """Return size, mean and standard deviation of the finite values."""
    sample = finite(values)
    n = sample.size
    if not n:
        return Description(0, math.nan, math.nan)
    mean = float(np.add.reduce(sample)) / n  # less overhead than `sample.mean()` and `sample.std()`
    differences = sample - mean
    std = math.sqrt(float(np.add.reduce(differences * differences)) / (n - 1)) if n > 1 else math.nan
    return Description(n, mean, std)


def mean_interval(sample: Description) -> tuple[float, float]:
    """Return Student's 95 % confidence interval of the mean; NaN without two values or any spread."""
    if sample.n < 2 or sample.std == 0:
        return math.nan, math.nan
    from scipy import special  # deferred, as it would double the import time of `analysis`

    margin = float(special.stdtrit(sample.n - 1, TAIL)) * sample.standard_error
    return sample.mean - margin, sample.mean + margin


def percent_interval(mean: float, margin: float) -> tuple[float, float]:
    """Return the 95 % confidence interval of a mean percentage, within 0 and 100.

    It is symmetric on the arcsine scale, by the delta method. For a mean of 0 or 100, where that fails, the
    symmetric interval is clipped.

    Args:
        mean: mean of percentages, in [0, 100].
        margin: half the width of the symmetric interval, in points; NaN if there is none.
    """
    if not 0 < mean < 100:
        return max(mean - margin, 0.0), min(mean + margin, 100.0)
    angle = math.asin(math.sqrt(mean / 100))
    spread = margin / 100 / math.sin(2 * angle)
    ends = max(angle - spread, 0.0), min(angle + spread, math.pi / 2)
    return 100 * math.sin(ends[0]) ** 2, 100 * math.sin(ends[1]) ** 2


def mean_percent_interval(sample: Description) -> tuple[float, float]:
    """Return the 95 % confidence interval of the mean of percentages, by Student's t, within 0 and 100."""
    _, high = mean_interval(sample)
    return percent_interval(sample.mean, high - sample.mean)


def mean_interval_of(
    mean: float, weights: Sequence[float], variances: Sequence[float], sizes: Sequence[int]
) -> tuple[float, float]:
    """Return Student's 95 % interval of a weighted mean of percentages over strata, within 0 and 100.

    Args:
        mean: weighted mean.
        weights: weight of each stratum.
        variances: variance of a run in each stratum, at least one above 0.
        sizes: number of runs in each stratum, 2 or more.
    """
    from scipy import special

    parts = np.asarray(weights, float) ** 2 / sum(weights) ** 2 * np.asarray(variances) / np.asarray(sizes)
    freedom = parts.sum() ** 2 / (parts**2 / (np.asarray(sizes) - 1)).sum()
    return percent_interval(mean, float(special.stdtrit(freedom, TAIL) * math.sqrt(parts.sum())))


def bounded_interval(value: float, n: int) -> tuple[float, float]:
    """Return the exact 95 % confidence interval of a mean percentage if all `n` runs have the same `value`.

    The probability of `value` is at least p = 0.05^(1/n) with 95 % confidence, so the mean is between
    p * value and p * value + 100 (1 - p).
    """
    p = (1 - CONFIDENCE) ** (1 / n)
    return p * value, p * value + 100 * (1 - p)


def finite(values: ArrayLike) -> NDArray[np.float64]:
    """Return the finite values of a sample (n,).

    Raises:
        ValueError: if the values are not numbers or not one-dimensional.
    """
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 1:
        raise ValueError(f"a sample of shape {array.shape}: expected (n,), one value a run")
    return array[np.isfinite(array)]


def holm(p_values: ArrayLike) -> NDArray[np.float64]:
    """Return p-values (n,) adjusted by Holm's method, leaving NaN as it is.

    Raises:
        ValueError: if a value is outside [0, 1].
    """
    values = np.asarray(p_values, dtype=np.float64)
    wrong = values[(values < 0) | (values > 1)]
    if wrong.size:
        raise ValueError(f"p = {wrong[0]:g}: expected values in [0, 1]")
    adjusted = np.full(values.shape, np.nan)
    order = np.argsort(values)[: np.isfinite(values).sum()]  # NaNs are sorted last
    steps = values[order] * np.arange(order.size, 0, -1)
    adjusted[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return adjusted


DEFAULT_MARGIN = 5.0  # equivalence margin of differences in mastered tasks, in points


class Standing(StrEnum):
    """Result of testing a statement against data.

    Attributes:
        SUPPORTED: interval excludes the contrary.
        REFUTED: interval excludes the statement, under the statement's own conditions.
        NOT_SEEN: interval excludes the statement, under other conditions.
        UNDECIDED: interval excludes neither.
        NO_DATA: complete results are missing.
    """

    SUPPORTED = "supported"
    REFUTED = "refuted"
    NOT_SEEN = "not seen here"
    UNDECIDED = "undecided"
    NO_DATA = "no data"


def contrary(standing: Standing) -> Standing:
    """Return the result for the negation of a statement: refuted for supported, and vice versa."""
    swapped = {Standing.SUPPORTED: Standing.REFUTED, Standing.REFUTED: Standing.SUPPORTED}
    return swapped.get(standing, standing)


def greater(low: float, high: float, margin: float = DEFAULT_MARGIN) -> Standing:
    """Return the result of testing "the difference is above 0", given its interval.

    It is supported if the interval is above 0, else refuted if the interval is below `margin`.
    """
    if low > 0:
        return Standing.SUPPORTED
    return Standing.REFUTED if high < margin else Standing.UNDECIDED


def equivalent(low: float, high: float, margin: float = DEFAULT_MARGIN) -> Standing:
    """Return the result of testing "the difference does not matter", given its interval.

    It is supported if the interval is within plus and minus `margin`, else refuted if it excludes 0.
    """
    if -margin < low and high < margin:
        return Standing.SUPPORTED
    return Standing.REFUTED if low > 0 or high < 0 else Standing.UNDECIDED
