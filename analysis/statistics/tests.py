"""Tests between samples of runs: Welch's, paired, permutation and stratified tests.

Common arguments: `pairs` are both groups' samples in each stratum, one value per run, indexed by run id;
`weights` are the weights of strata, in any unit; `seeds` are the seeds of runs by id.
"""

import itertools
import math
from collections import Counter
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from analysis.statistics.samples import EQUAL, SIGNIFICANCE, TAIL, Description, describe, finite, negligible
from tma_ray.support.validation import check_type

MOST_ARRANGEMENTS = 20_000
"""Maximum number of arrangements that are enumerated; two samples of 8 runs have 12,870."""

DRAWN_ARRANGEMENTS = 9_999
"""Number of arrangements drawn at random if there are more, so that the smallest p is 1 in 10,000 (Davison
and Hinkley, 1997)."""

PERMUTATION_SEED = 0  # seed of random arrangements, fixed so that p depends only on the samples

Floats = NDArray[np.float64]


def permutation_p(pairs: Sequence[tuple[ArrayLike, ArrayLike]], weights: Sequence[float] = (1.0,)) -> float:
    """Return the two-sided p-value of a weighted mean difference by a permutation test within strata."""
    strata = [tuple(np.asarray(group, np.float64) for group in pair) for pair in pairs]
    observed = sum(weight * (a.mean() - b.mean()) for weight, (a, b) in zip(weights, strata, strict=True))
    scale = max(float(np.abs(np.concatenate(stratum)).max()) for stratum in strata) * sum(weights)
    exact = math.prod(math.comb(len(a) + len(b), len(a)) for a, b in strata) <= MOST_ARRANGEMENTS
    rng, differences = np.random.default_rng(PERMUTATION_SEED), np.zeros(1)
    for weight, (a, b) in zip(weights, strata, strict=True):
        values, n = np.concatenate([a, b]), len(a)
        if exact:
            chosen = values[np.array(list(itertools.combinations(range(len(values)), n)))]
        else:
            permuted = np.broadcast_to(values, (DRAWN_ARRANGEMENTS, len(values)))
            chosen = rng.permuted(permuted, axis=1)[:, :n]
        sums = chosen.sum(axis=1)
        terms = weight * (sums / n - (values.sum() - sums) / len(b))
        differences = np.add.outer(differences, terms).ravel() if exact else differences + terms
    return _extreme_share(differences if exact else np.append(differences, observed), observed, scale)


def sign_flip_p(differences: ArrayLike) -> float:
    """Return the two-sided p-value of paired differences (n,) by the sign-flip test."""
    values = np.asarray(differences, np.float64)
    observed, scale = float(values.mean()), float(np.abs(values).max())
    if 2 ** len(values) <= MOST_ARRANGEMENTS:
        signs = np.array(list(itertools.product((1.0, -1.0), repeat=len(values))))
        return _extreme_share(signs @ values / len(values), observed, scale)
    rng = np.random.default_rng(PERMUTATION_SEED)
    signs = rng.choice((1.0, -1.0), (DRAWN_ARRANGEMENTS, len(values)))
    return _extreme_share(np.append(signs @ values / len(values), observed), observed, scale)


def _extreme_share(differences: Floats, observed: float, scale: float) -> float:
    """Return the share of `differences` at least as far from 0 as `observed`."""
    return float(np.mean(np.abs(differences) >= abs(observed) - EQUAL * scale))


ROUNDING = 1e-9  # shares this close to 0 or 1 are rounded
ALL_EQUAL = "no spread between seeds"  # reason for no test: all values are equal

SINGLE_RUN = "needs 2 seeds"  # reason for no test: a sample of fewer than two runs


class Method(StrEnum):
    """Test behind a p-value.

    Attributes:
        WELCH: Welch's t-test, over one or several strata.
        PAIRED: Student's t-test of paired differences.
        PERMUTATION: permutation test, where a standard deviation is 0.
        SIGN_FLIP: sign-flip test of paired differences, where their standard deviation is 0.
        NONE: no test.
    """

    WELCH = "Welch"
    PAIRED = "paired"
    PERMUTATION = "permutation"
    SIGN_FLIP = "sign flip"
    NONE = ""


class Scale(StrEnum):
    """Scale on which percentages are tested.

    Attributes:
        PERCENT: percentages.
        ARCSINE: arcsine of the square root of shares, which stabilises the variance of means of many shares
            (Bartlett, 1947).
    """

    PERCENT = "percent"
    ARCSINE = "arcsine"

    def of(self, percentages: pd.Series) -> pd.Series:
        """Convert percentages to the scale; arcsines are radians in [0, pi / 2].

        Shares within `ROUNDING` of 0 or 1 are rounded: the arcsine's slope there magnifies rounding errors.

        Raises:
            ValueError: if a value is not a percentage.
        """
        if self is Scale.PERCENT:
            return percentages
        shares = percentages.to_numpy(float) / 100  # as an array, since operations on many series are slow
        wrong = shares[(shares < -ROUNDING) | (shares > 1 + ROUNDING)]
        if len(wrong):
            raise ValueError(f"{100 * wrong[0]:g}: expected percentages, in [0, 100], to test arcsines")
        exact = np.where(shares < ROUNDING, 0.0, np.where(shares > 1 - ROUNDING, 1.0, shares))
        return pd.Series(np.arcsin(np.sqrt(exact)), index=percentages.index)


@dataclass(frozen=True)
class Comparison:
    """Comparison of the means of a sample and a reference; NaN where a number is missing.

    Attributes:
        n: number of values in the sample.
        reference_n: number of values in the reference.
        difference: mean of the sample less that of the reference.
        low: lower end of the difference's 95 % confidence interval; NaN without any spread.
        high: upper end of the interval.
        t: test statistic of a t-test.
        degrees_of_freedom: degrees of freedom of a t-test.
        p: two-sided p-value.
        reason: reason why there is no test; empty if there is one.
        method: test behind p.
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
        """True if p is below `SIGNIFICANCE`."""
        return self.p < SIGNIFICANCE


def welch(sample: pd.Series, reference: pd.Series) -> Comparison:
    """Compare the means of two independent samples by Welch's (1947) test.

    Where a standard deviation is 0, as for a teacher that masters nothing, p is that of the permutation test.
    The interval is then Welch's, extended to 0 if p is not significant, or missing if neither has any spread.

    Args:
        sample: one value per run, indexed by run id.
        reference: values of the other sample. Samples with a run in common are not independent, and not
            tested.
    """
    for name, values in {"sample": sample, "reference": reference}.items():
        check_type(name, values, pd.Series, "a series of one value a run, indexed by run id")
    if set(sample.index) & set(reference.index):
        first, second = describe(sample), describe(reference)
        return Comparison(first.n, second.n, first.mean - second.mean, reason="same runs")
    return welch_of_values(sample, reference)


def welch_of_values(sample: ArrayLike, reference: ArrayLike) -> Comparison:
    """Compare the means of two independent samples, given as arrays (n,), by Welch's test."""
    first, second = describe(sample), describe(reference)
    test = welch_from_statistics(first, second)
    if test.reason or first.std == second.std or min(first.std, second.std) > 0:
        return test
    p, low, high = permutation_p([(finite(sample), finite(reference))]), test.low, test.high
    if not p < SIGNIFICANCE:
        low, high = min(low, 0.0), max(high, 0.0)
    return Comparison(first.n, second.n, test.difference, low=low, high=high, p=p, method=Method.PERMUTATION)


def welch_from_statistics(first: Description, second: Description) -> Comparison:
    """Compare the means of two independent samples, given their sizes, means and standard deviations.

    Without any spread, p is that of the permutation test.
    """
    difference, reason = first.mean - second.mean, ""
    if min(first.n, second.n) < 2:
        reason = SINGLE_RUN
    elif not (math.isfinite(first.std) and math.isfinite(second.std)):
        reason = "no standard deviation"
    elif first.std == second.std == 0 and _same_mean(first, second):
        reason = ALL_EQUAL
    if reason:
        return Comparison(first.n, second.n, difference, reason=reason)
    if first.std == 0 and second.std == 0:
        p = permutation_p([([first.mean] * first.n, [second.mean] * second.n)])
        return Comparison(first.n, second.n, difference, p=p, method=Method.PERMUTATION)
    return t_test(first.n, second.n, difference, *standard_error_of_difference(first, second))


def _same_mean(first: Description, second: Description) -> bool:
    """Return True if two means differ by no more than a rounding error."""
    return bool(negligible(first.mean - second.mean, max(abs(first.mean), abs(second.mean))))


def standard_error_of_difference(first: Description, second: Description) -> tuple[float, float]:
    """Return the standard error of a difference of means, and its Welch-Satterthwaite degrees of freedom.

    Both samples need two values, and one of them a standard deviation above 0.
    """
    variances = first.standard_error**2, second.standard_error**2
    parts = (variance**2 / (n - 1) for variance, n in zip(variances, (first.n, second.n), strict=True))
    return math.sqrt(sum(variances)), sum(variances) ** 2 / sum(parts)


def stratified(
    pairs: Sequence[tuple[pd.Series, pd.Series]],
    weights: Sequence[float],
    least: Sequence[float] = (),
    described: Sequence[tuple[Description, Description]] = (),
) -> Comparison:
    """Compare the means of two groups over common strata, such as the challenges of a benchmark.

    The difference is the weighted mean of the strata's differences, with Welch-Satterthwaite degrees of
    freedom over all samples. Least variances widen the standard error and leave the degrees of freedom as
    they are, so p never falls. Without any spread, p is that of the permutation test within strata, and the
    interval is missing.

    Args:
        pairs: both samples of each stratum, one value per run, indexed by run id.
        weights: weight of each stratum.
        least: `least_variance` of each stratum; 0 by default.
        described: descriptions of `pairs`, if they are known.
    """
    samples = described or [(describe(first), describe(second)) for first, second in pairs]
    if not samples:
        return Comparison(0, 0, math.nan, reason="nothing in common")
    n, reference_n = (sum(sample.n for sample in group) for group in zip(*samples, strict=True))
    shares = [weight / sum(weights) for weight in weights]
    terms = zip(shares, samples, strict=True)
    difference = sum(share * (first.mean - second.mean) for share, (first, second) in terms)
    constant = not any(sample.std > 0 for pair in samples for sample in pair)
    reason = ""
    if _share_a_run(pairs):
        reason = "same runs"
    elif min(sample.n for pair in samples for sample in pair) < 2:
        reason = SINGLE_RUN
    elif constant and all(_same_mean(first, second) for first, second in samples):
        reason = ALL_EQUAL
    if reason:
        return Comparison(n, reference_n, difference, reason=reason)
    if constant:
        p = permutation_p([(finite(first), finite(second)) for first, second in pairs], shares)
        return Comparison(n, reference_n, difference, p=p, method=Method.PERMUTATION)
    parts = [
        (share**2 * sample.std**2 / sample.n, share**2 * bound / sample.n, sample.n - 1)
        for share, pair, bound in zip(shares, samples, least or [0.0] * len(pairs), strict=True)
        for sample in pair
    ]
    variance = sum(term for term, _, _ in parts)
    freedom = variance**2 / sum(term**2 / count for term, _, count in parts)
    error = math.sqrt(sum(max(term, bound) for term, bound, _ in parts))
    return t_test(n, reference_n, difference, error, freedom)


def stratum_weights(challenges: Sequence[Hashable]) -> list[float]:
    """Return the weight of each stratum, 1 over the number of strata of its challenge.

    Leaderboards, tests, claims and trials use these weights: a challenge counts once, however many strata it
    has.
    """
    sizes = Counter(challenges)
    return [1 / sizes[challenge] for challenge in challenges]


LEAST_VARIANCE_SHARE = 0.5
"""Lower bound for the variance of a group, as a share of the mean variance of its stratum's groups."""


def least_variance(samples: Iterable[Description]) -> float:
    """Return a lower bound for variances in a stratum: `LEAST_VARIANCE_SHARE` of the groups' mean variance.

    Some runs never learn to walk. If by chance all seeds of a group do, or none, its variance is too small,
    and tests of all pairs find too many differences (`docs/statistics.md`).

    Args:
        samples: groups in the stratum; those with fewer than two values are ignored.
    """
    variances = [sample.std**2 for sample in samples if sample.n > 1]
    return LEAST_VARIANCE_SHARE * sum(variances) / len(variances) if variances else 0.0


def _share_a_run(pairs: Sequence[tuple[pd.Series, pd.Series]]) -> bool:
    """Return True if any run is in both groups, whether or not in the same stratum."""
    first, second = (set().union(*(sample.index for sample in group)) for group in zip(*pairs, strict=True))
    return bool(first & second)


def t_test(
    n: int, reference_n: int, difference: float, error: float, freedom: float, method: Method = Method.WELCH
) -> Comparison:
    """Return the t-test of a difference, given its standard error and degrees of freedom."""
    from scipy import special  # not `stats`, which takes a second to import

    t = difference / error
    margin = float(special.stdtrit(freedom, TAIL)) * error
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


def simultaneous_intervals(
    difference: Floats, low: Floats, high: Floats, freedom: Floats, holm: Floats
) -> tuple[Floats, Floats]:
    """Return simultaneous 95 % intervals for a family of differences.

    Student's intervals with Bonferroni's correction are adjusted to Holm's results: they end at 0 where only
    a later step of Holm's method finds a difference. Permutation tests keep their own interval, extended to 0
    unless significant.

    Args:
        difference: differences (n,).
        low: lower ends of the single 95 % intervals (n,).
        high: upper ends of these intervals (n,).
        freedom: degrees of freedom (n,); NaN for other tests than t-tests.
        holm: p-values after Holm's correction for the family (n,); NaN without a test.
    """
    from scipy import special

    tests = max(int(np.isfinite(holm).sum()), 1)
    wider = special.stdtrit(freedom, 1 - SIGNIFICANCE / 2 / tests) / special.stdtrit(freedom, TAIL)
    margin = np.where(np.isfinite(wider), wider, 1.0)
    low, high = difference - margin * (difference - low), difference + margin * (high - difference)
    better, worse = (holm < SIGNIFICANCE) & (difference > 0), (holm < SIGNIFICANCE) & (difference < 0)
    low = np.where(better, np.maximum(low, 0.0), np.where(worse, low, np.minimum(low, 0.0)))
    high = np.where(worse, np.minimum(high, 0.0), np.where(better, high, np.maximum(high, 0.0)))
    return low, high


FEW_PAIRS = "fewer than 2 seeds in common"  # reason for no paired test


def paired(sample: pd.Series, reference: pd.Series) -> Comparison:
    """Compare the means of two paired samples by Student's t-test.

    Where all differences are equal up to rounding errors, p is that of the sign-flip test, and the interval
    is missing; where all are 0, the test is missing, too.

    Args:
        sample: one value per seed, indexed by seed.
        reference: values of the other sample; seeds that only one sample has are ignored.

    Returns:
        Comparison whose n and reference_n are the number of pairs.
    """
    differences = (sample - reference).dropna()
    pairs = describe(differences)
    n, mean = pairs.n, pairs.mean
    if n < 2:
        reason = FEW_PAIRS if min(sample.count(), reference.count()) > 1 else "needs 2 seeds"
        return Comparison(n, n, mean, reason=reason)
    largest = max(values.loc[differences.index].abs().max() for values in (sample, reference))
    if negligible([pairs.std, mean], largest).all():
        return Comparison(n, n, mean, reason=ALL_EQUAL)
    if negligible(pairs.std, largest):
        return Comparison(n, n, mean, p=sign_flip_p(differences), method=Method.SIGN_FLIP)
    return t_test(n, n, mean, pairs.standard_error, n - 1, Method.PAIRED)


def paired_strata(
    pairs: Sequence[tuple[pd.Series, pd.Series]], weights: Sequence[float], seeds: Mapping[Any, Hashable]
) -> Comparison:
    """Compare the means of two groups over common strata, paired by seed.

    The difference of a pair is its weighted mean over strata, so runs with the same seed count once.
    """
    if not pairs:
        return Comparison(0, 0, math.nan, reason="nothing in common")
    first, second = (seed_means(group, weights, seeds) for group in zip(*pairs, strict=True))
    if _share_a_run(pairs):
        difference = float(first.mean() - second.mean())
        return Comparison(len(first), len(second), difference, reason="same runs")
    return paired(first, second)


def seed_means(
    samples: Sequence[pd.Series], weights: Sequence[float], seeds: Mapping[Any, Hashable]
) -> pd.Series:
    """Return the weighted mean over strata for each seed that occurs in all strata, indexed by seed.

    Runs with the same seed in a stratum are averaged first.
    """
    parts: list[dict[Hashable, float]] = []
    for sample in samples:
        values: dict[Hashable, list[float]] = {}
        for run, value in zip(sample.index, sample.to_numpy(float), strict=True):
            if math.isfinite(value):
                values.setdefault(seeds[run], []).append(value)
        parts.append({seed: sum(runs) / len(runs) for seed, runs in values.items()})
    common = [seed for seed in parts[0] if all(seed in part for part in parts)]
    table = np.array([[part[seed] for seed in common] for part in parts])
    return pd.Series(np.asarray(weights, float) @ table / sum(weights), index=common, dtype=float)
