"""Samples of runs and intervals of their means, corrections for many tests, and verdicts by a margin."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

CONFIDENCE = 0.95
"""Coverage of the confidence intervals."""

TAIL = (1 + CONFIDENCE) / 2
"""Probability under the upper end of one."""

SIGNIFICANCE = 0.05
"""Two samples differ significantly when p is strictly under this (paper, appendix on results)."""


EQUAL = 1e-9
"""Share of the values up to which a difference or a deviation is a rounding error."""


def negligible(deviations: ArrayLike, values: ArrayLike) -> NDArray[np.bool_]:
    """Return a mask of the deviations that are rounding errors of `values`, such as their mean.

    This alone decides which samples have no spread between seeds and which means are equal.

    Args:
        deviations: differences or standard deviations of any shape.
        values: values that they are measured against, of a shape that broadcasts; NaN makes none negligible.
    """
    return np.asarray(np.abs(deviations) <= EQUAL * np.abs(values))


def deviations(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the deviations of values (..., n) from their means over n, 0 in place of rounding errors."""
    means = values.mean(axis=-1, keepdims=True)
    differences = values - means
    return np.where(negligible(differences, means), 0.0, differences)


@dataclass(frozen=True)
class Description:
    """A sample in four numbers; NaN where the sample is too small for one.

    Attributes:
        n: finite values in the sample.
        mean: arithmetic mean.
        std: standard deviation with n - 1 degrees of freedom; needs two values. 0 in place of a rounding
            error of the mean.
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
    """A number with its 95 % confidence interval.

    Attributes:
        value: estimate of the sample itself; NaN where it has none.
        low: lower end of the interval; NaN where there is none.
        high: upper end of it.
        n: runs of the sample, of both for a comparison.
        reason: reason why the interval is missing; empty where it is not.
    """

    value: float
    low: float
    high: float
    n: int
    reason: str = ""


def describe(values: ArrayLike) -> Description:
    """Return n, mean, standard deviation and standard error of the finite ones among `values`."""
    sample = finite(values)
    n = sample.size
    if not n:
        return Description(0, math.nan, math.nan)
    mean = float(np.add.reduce(sample)) / n  # as `mean` and `std` do: reports have tens of thousands of these
    differences = sample - mean
    std = math.sqrt(float(np.add.reduce(differences * differences)) / (n - 1)) if n > 1 else math.nan
    return Description(n, mean, std)


def mean_interval(sample: Description) -> tuple[float, float]:
    """Return the 95 % confidence interval of the mean, by Student's t.

    NaN under two values and without any spread, where no method holds: equal values do not show that the mean
    is known.
    """
    if sample.n < 2 or sample.std == 0:
        return math.nan, math.nan
    from scipy import special  # half of the time that `import analysis` takes otherwise

    margin = float(special.stdtrit(sample.n - 1, TAIL)) * sample.standard_error
    return sample.mean - margin, sample.mean + margin


def percent_interval(mean: float, margin: float) -> tuple[float, float]:
    """Return the 95 % confidence interval of a mean percentage, which stays within 0 and 100.

    It is symmetric in the arcsine of the root of the mean's share, whose standard error follows from that of
    the mean (delta method). A mean of 0 or 100, where that has none, keeps the symmetric interval, cut there.

    Args:
        mean: mean of percentages, in [0, 100].
        margin: half the width of its symmetric interval, in points; NaN where there is none.
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
    """Return the 95 % confidence interval of a weighted mean of strata's mean percentages, within 0 and 100.

    Student's, with Welch and Satterthwaite's degrees of freedom.

    Args:
        mean: weighted mean.
        weights: weight of each stratum.
        variances: variance of a run in each, of which one is over 0.
        sizes: runs of each, 2 or more.
    """
    from scipy import special

    parts = np.asarray(weights, float) ** 2 / sum(weights) ** 2 * np.asarray(variances) / np.asarray(sizes)
    freedom = parts.sum() ** 2 / (parts**2 / (np.asarray(sizes) - 1)).sum()
    return percent_interval(mean, float(special.stdtrit(freedom, TAIL) * math.sqrt(parts.sum())))


def bounded_interval(value: float, n: int) -> tuple[float, float]:
    """Return the exact 95 % confidence interval of the mean of percentages where `n` runs all have `value`.

    If runs have it with a probability under p = 0.05^(1/n), all of n do in less than 5 % of samples. With p,
    the mean is from p value to p value + 100 (1 - p), whatever the others are.
    """
    p = (1 - CONFIDENCE) ** (1 / n)
    return p * value, p * value + 100 * (1 - p)


def finite(values: ArrayLike) -> NDArray[np.float64]:
    """Return the finite ones among `values` (n,).

    Raises:
        ValueError: they have another number of dimensions, or are not numbers.
    """
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 1:
        raise ValueError(f"a sample of shape {array.shape}: expected (n,), one value a run")
    return array[np.isfinite(array)]


def holm(p_values: ArrayLike) -> NDArray[np.float64]:
    """Return Holm's adjustment of `p_values` (n,) for testing n hypotheses at once; NaN stays NaN.

    Raises:
        ValueError: a value is outside [0, 1].
    """
    values = np.asarray(p_values, dtype=np.float64)
    wrong = values[(values < 0) | (values > 1)]
    if wrong.size:
        raise ValueError(f"p = {wrong[0]:g}: expected values in [0, 1]")
    adjusted = np.full(values.shape, np.nan)
    order = np.argsort(values)[: np.isfinite(values).sum()]  # NaN sorts last
    steps = values[order] * np.arange(order.size, 0, -1)
    adjusted[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return adjusted


DEFAULT_MARGIN = 5.0
"""Points of mastered tasks under which a difference does not matter."""


class Standing(StrEnum):
    """Standing of a statement held against results.

    Attributes:
        SUPPORTED: the interval leaves no doubt of it.
        REFUTED: the interval leaves no doubt of its contrary, under the conditions of the statement.
        NOT_SEEN: the same under other conditions, which do not refute it.
        UNDECIDED: the interval allows for both.
        NO_DATA: complete results to hold it against are missing.
    """

    SUPPORTED = "supported"
    REFUTED = "refuted"
    NOT_SEEN = "not seen here"
    UNDECIDED = "undecided"
    NO_DATA = "no data"


def contrary(standing: Standing) -> Standing:
    """Return the standing of a statement's negation."""
    swapped = {Standing.SUPPORTED: Standing.REFUTED, Standing.REFUTED: Standing.SUPPORTED}
    return swapped.get(standing, standing)


def greater(low: float, high: float, margin: float = DEFAULT_MARGIN) -> Standing:
    """Return the standing of "the difference is over 0", by its interval.

    Supported where the whole interval is over 0; else refuted where it is under `margin`, so that a
    difference that matters is ruled out. An interval of NaN decides nothing.
    """
    if low > 0:
        return Standing.SUPPORTED
    return Standing.REFUTED if high < margin else Standing.UNDECIDED


def equivalent(low: float, high: float, margin: float = DEFAULT_MARGIN) -> Standing:
    """Return the standing of "the difference does not matter", by the interval of the difference.

    Supported where the interval is within plus and minus `margin`; else refuted where it leaves out 0. An
    interval of NaN decides nothing.
    """
    if -margin < low and high < margin:
        return Standing.SUPPORTED
    return Standing.REFUTED if low > 0 or high < 0 else Standing.UNDECIDED
