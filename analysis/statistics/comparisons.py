"""Tests between two samples of runs, between published means and deviations, and over strata."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
import pandas as pd

from analysis.statistics.permutations import permutation_p
from analysis.statistics.samples import CONFIDENCE, SIGNIFICANCE, Description, describe, finite
from tma_ray.commands.arguments import check_kind

ROUNDING = 1e-9
"""Share by which rounding may take a percentage beyond 0 or 100."""

ALL_EQUAL = "no spread between seeds"
"""Why two samples are not tested whose values are all the same."""


class Method(StrEnum):
    """Test that a p-value comes from.

    Attributes:
        WELCH: Welch's t-test, of one stratum or of several.
        PAIRED: Student's t-test of paired differences.
        PERMUTATION: runs change groups, where a standard deviation is 0.
        SIGN_FLIP: paired differences change signs, where their standard deviation is 0.
        NONE: no test was made.
    """

    WELCH = "Welch"
    PAIRED = "paired"
    PERMUTATION = "permutation"
    SIGN_FLIP = "sign flip"
    NONE = ""


class Scale(StrEnum):
    """Scale on which means of percentages are tested.

    Attributes:
        PERCENT: percentages as they are.
        ARCSINE: arcsine of the root of a share, on which seeds of a measure that is a mean of many shares
            scatter alike, whether they master little or much (Bartlett, 1947).
    """

    PERCENT = "percent"
    ARCSINE = "arcsine"

    def of(self, percentages: pd.Series) -> pd.Series:
        """Returns `percentages` on this scale; arcsines are in radians, from 0 to half of pi.

        Raises:
            ValueError: a value is not a percentage.
        """
        if self is Scale.PERCENT:
            return percentages
        shares = percentages.astype(float) / 100
        wrong = shares[(shares < -ROUNDING) | (shares > 1 + ROUNDING)]
        if len(wrong):
            raise ValueError(f"{100 * wrong.iloc[0]:g}: expected percentages, in [0, 100], to test arcsines")
        return pd.Series(np.arcsin(np.sqrt(shares.clip(0.0, 1.0).to_numpy())), index=percentages.index)


@dataclass(frozen=True)
class Comparison:
    """A test of the mean of a sample against a reference's; NaN where there is none.

    Attributes:
        n: values in the sample.
        reference_n: values in the reference.
        difference: mean of the sample minus mean of the reference.
        low: lower end of the 95 % confidence interval of `difference`; NaN where no method holds, as between
            two samples without any spread.
        high: upper end of it.
        t: test statistic of a t-test.
        degrees_of_freedom: Welch and Satterthwaite's, seldom whole.
        p: two-sided p-value.
        reason: why it was not tested; empty where it was.
        method: test that p comes from.
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
    method: Method = Method.NONE

    @property
    def significant(self) -> bool:
        """Whether there is a test and its p-value is under 0.05."""
        return self.p < SIGNIFICANCE


def welch(sample: pd.Series, reference: pd.Series) -> Comparison:
    """Compares the means of two independent samples without assuming equal variances.

    Where a standard deviation is 0, as of a teacher that masters nothing with any seed, p is that of the
    permutation test. With spread in the other sample the interval is Welch's, widened to hold 0 where p is
    not under 0.05; with none in either the interval is missing.

    Args:
        sample: one value per run, indexed by run id.
        reference: likewise; two samples that have a run in common are not independent and get no
            test, so that cells which share their runs are never compared with themselves.
    """
    for name, values in {"sample": sample, "reference": reference}.items():
        check_kind(name, values, pd.Series, "a series of one value a run, indexed by run id")
    first, second = describe(sample), describe(reference)
    if set(sample.index) & set(reference.index):
        return Comparison(first.n, second.n, first.mean - second.mean, reason="same runs")
    if _obstacle(first, second) or min(first.std, second.std) > 0:
        return welch_from_statistics(first, second)
    if first.std == second.std:
        return welch_from_statistics(first, second)
    p = permutation_p([(finite(sample), finite(reference))])
    return _permuted(welch_from_statistics(first, second), p)


def _permuted(test: Comparison, p: float) -> Comparison:
    """Returns Welch's interval with the p of the permutation test, which it must not contradict."""
    low, high = test.low, test.high
    if not p < SIGNIFICANCE:
        low, high = min(low, 0.0), max(high, 0.0)
    freedom = math.nan
    return replace(
        test, low=low, high=high, t=math.nan, degrees_of_freedom=freedom, p=p, method=Method.PERMUTATION
    )


def welch_from_statistics(first: Description, second: Description) -> Comparison:
    """Compares the means of two independent samples of which only n, mean and std are known.

    Without any spread in either all values are known, and p is that of the permutation test.

    Args:
        first: the sample, as in a published table.
        second: the reference.
    """
    difference = first.mean - second.mean
    reason = _obstacle(first, second)
    if reason:
        return Comparison(first.n, second.n, difference, reason=reason)
    if first.std == 0 and second.std == 0:
        p = permutation_p([([first.mean] * first.n, [second.mean] * second.n)])
        return Comparison(first.n, second.n, difference, p=p, method=Method.PERMUTATION)
    return t_test(first.n, second.n, difference, *standard_error_of_difference(first, second))


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
    if first.std == second.std == 0 and first.mean == second.mean:
        return ALL_EQUAL
    return ""


def stratified(pairs: Sequence[tuple[pd.Series, pd.Series]], weights: Sequence[float]) -> Comparison:
    """Compares the means of two groups over strata that both have, such as the challenges of a benchmark.

    The difference is the weighted mean of the strata's differences. Samples of a stratum need not have equal
    variances, nor strata each other's: the degrees of freedom are Welch and Satterthwaite's over all of them.

    Where no sample of any stratum has a spread, p is that of the permutation test within strata, and
    the interval is missing.

    Args:
        pairs: samples of both groups in each stratum, one value a run, indexed by run id.
        weights: of the strata; they need not add up to 1.
    """
    samples = [(describe(first), describe(second)) for first, second in pairs]
    if not samples:
        return Comparison(0, 0, math.nan, reason="nothing in common")
    n, reference_n = (sum(sample.n for sample in group) for group in zip(*samples, strict=True))
    shares = [weight / sum(weights) for weight in weights]
    terms = zip(shares, samples, strict=True)
    difference = sum(share * (first.mean - second.mean) for share, (first, second) in terms)
    reason = _obstacle_of_strata(pairs, samples)
    if reason:
        return Comparison(n, reference_n, difference, reason=reason)
    if not any(sample.std > 0 for pair in samples for sample in pair):
        p = permutation_p([(finite(first), finite(second)) for first, second in pairs], shares)
        return Comparison(n, reference_n, difference, p=p, method=Method.PERMUTATION)
    parts = [
        ((share * sample.standard_error) ** 2, sample.n - 1)
        for share, pair in zip(shares, samples, strict=True)
        for sample in pair
    ]
    variance = sum(part for part, _ in parts)
    freedom = variance**2 / sum(part**2 / own for part, own in parts)
    return t_test(n, reference_n, difference, math.sqrt(variance), freedom)


def _obstacle_of_strata(
    pairs: Sequence[tuple[pd.Series, pd.Series]], samples: Sequence[tuple[Description, Description]]
) -> str:
    runs = [set().union(*(group.index for group in groups)) for groups in zip(*pairs, strict=True)]
    if runs[0] & runs[1]:
        return "same runs"
    if min(sample.n for pair in samples for sample in pair) < 2:
        return "needs 2 seeds"
    constant = all(sample.std == 0 for pair in samples for sample in pair)
    return ALL_EQUAL if constant and all(first.mean == second.mean for first, second in samples) else ""


def tested_on(scaled: Comparison, shown: Comparison) -> Comparison:
    """Returns a difference in percentages with the test that was made on another scale.

    The interval is that of the percentages, except where it contradicts the test: without a finding it is
    widened to hold 0, and an end that would hold 0 beside a finding is that of the test's own interval,
    in proportion to the difference. Where the two scales disagree on who is better, p is 1: the test is
    of the direction that is shown.

    Args:
        scaled: the comparison on the other scale.
        shown: the comparison of the same samples in percentages.
    """
    if scaled.reason:
        return replace(scaled, difference=shown.difference)
    p = scaled.p if scaled.difference * shown.difference > 0 else 1.0
    low, high = shown.low, shown.high
    if not p < SIGNIFICANCE:
        low, high = min(low, 0.0), max(high, 0.0)
    elif low <= 0 <= high:
        ratio = shown.difference / scaled.difference
        low, high = ratio * scaled.low, ratio * scaled.high
    return replace(scaled, difference=shown.difference, low=low, high=high, p=p)


def t_test(
    n: int, reference_n: int, difference: float, error: float, freedom: float, method: Method = Method.WELCH
) -> Comparison:
    """Returns the t-test of a difference with standard error `error` and `freedom` degrees of freedom."""
    from scipy import special  # `stats` has the same functions, and takes a second to import

    t = difference / error
    margin = float(special.stdtrit(freedom, (1 + CONFIDENCE) / 2)) * error
    return Comparison(
        n=n,
        reference_n=reference_n,
        difference=difference,
        low=difference - margin,
        high=difference + margin,
        t=t,
        degrees_of_freedom=freedom,
        p=2 * float(special.stdtr(freedom, -abs(t))),
        method=method,
    )
