"""Interquartile means, probabilities of improvement and performance profiles (Agarwal et al., 2021).

A sample is made of strata, such as the bodies of a pool or the challenges of an environment: a mapping from
the name of each to its values (n,), one a run, indexed by run id. Runs of one of the `clusters` depend on
each other; by default all are independent.

Their authors' intervals are percentiles of bootstrap samples, which hold in 55 % of all cases with two seeds
and in 74 % with three. These here hold with few seeds, too; `docs/statistics.md` has their coverage.
"""

import math
from collections.abc import Hashable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy import special

from analysis.statistics.samples import TAIL, Estimate, deviations, negligible

TRIMMED = 0.25
"""Share of the runs that an interquartile mean leaves out at each end, rounded down to whole runs."""

Strata: TypeAlias = Mapping[str, pd.Series]

Clusters: TypeAlias = Mapping[Any, Hashable]
"""Keys of runs that depend on each other, such as their seeds, by run id."""

Floats: TypeAlias = NDArray[np.float64]


def interquartile_mean(values: ArrayLike, axis: int = -1) -> Any:
    """Return the mean of the middle half: a quarter of the values, rounded down, is cut at each end."""
    from scipy import stats  # it takes a second to import

    return stats.trim_mean(np.asarray(values, dtype=float), TRIMMED, axis=axis)


def interquartile_mean_of(sample: Strata, clusters: Clusters | None = None) -> Estimate:
    """Return the interquartile mean of all runs of all strata together, each run with equal weight.

    The interval is Tukey and McLaughlin's (1963): Student's t with the winsorised variance within each
    stratum, and Satterthwaite's degrees of freedom over the strata; or that with the variance of the
    untrimmed mean where this is wider, since a winsorised variance of five runs comes out too small.
    Where runs depend on each other, the variance is that of the sums of clusters.
    """
    strata = [part for _, part in sorted(_finite(sample).items())]
    parts = [part.to_numpy() for part in strata]
    n = sum(map(len, parts))
    if not n:
        return Estimate(math.nan, math.nan, math.nan, 0, "no results")
    values = np.sort(np.concatenate(parts))
    cut = int(n * TRIMMED)
    kept = n - 2 * cut
    value = float(values[cut : n - cut].mean())
    if min(map(len, parts)) < 2:
        return Estimate(value, math.nan, math.nan, n, "needs 2 seeds")
    winsorised = [np.clip(part, values[cut], values[n - cut - 1]) * (n / kept) for part in parts]
    if clusters is None:
        margin = max(_margin(winsorised, [len(part) * kept / n - 1 for part in parts]), _margin(parts))
    else:
        names = [clusters[run] for part in strata for run in part.index]
        margin = max(_margin_of_clusters(winsorised, names, kept / n), _margin_of_clusters(parts, names))
    return Estimate(value, value - margin, value + margin, n)


def probability_of_improvement(first: Strata, second: Strata) -> Estimate:
    """Return the probability that a run of `first` beats one of `second`, ties counting half.

    It is Mann and Whitney's U over the number of pairs, averaged over strata with equal weight. The interval
    of a stratum is Newcombe's (2006, method 5) with Student's t in place of the normal quantile; those of
    several strata are joined by Zou and Donner's (2008) method of variance estimates recovery. All stay
    within 0 and 1. Samples that share a run, or that are not of the same strata, have no estimate.
    """
    ours, theirs = _finite(first), _finite(second)
    n = sum(map(len, (*ours.values(), *theirs.values())))
    runs = [{run for part in group.values() for run in part.index} for group in (first, second)]
    reason = "same runs" if runs[0] & runs[1] else "other strata" if set(ours) != set(theirs) else ""
    if reason or not n:
        return Estimate(math.nan, math.nan, math.nan, n, reason or "no results")
    pairs = [(ours[name].to_numpy(), theirs[name].to_numpy()) for name in sorted(ours)]
    shares = [_share_of_wins(x[:, None], y[None, :]) for x, y in pairs]
    value = float(np.mean(shares))
    if min(len(part) for pair in pairs for part in pair) < 2:
        return Estimate(value, math.nan, math.nan, n, "needs 2 seeds")
    ends = [_newcombe(share, len(x), len(y)) for share, (x, y) in zip(shares, pairs, strict=True)]
    below, above = (
        math.sqrt(sum((share - end[side]) ** 2 for share, end in zip(shares, ends, strict=True))) / len(ends)
        for side in (0, 1)
    )
    return Estimate(value, value - below, value + above, n)


def signal_to_noise(strata: Sequence[Mapping[str, ArrayLike]]) -> Estimate:
    """Return the ratio of the deviation between teachers to that between seeds, shrunken by chance.

    With F = n v / s², where v is the mean variance of the teachers' means in a stratum and s² the pooled
    variance of seeds with f degrees of freedom, the square is (F (f - 2) / f - 1) / n, or 0 if that is less:
    unbiased before it is cut. The interval is exact for normal teachers and seeds, whose F is distributed as
    1 + n times the square, times Fisher's F. Where seeds differ in number, n is the harmonic mean.

    Args:
        strata: the values (n,), one a seed, of each of several teachers; one mapping a task space.
    """
    samples = [[np.asarray(values, float) for values in stratum.values()] for stratum in strata]
    each = [values for stratum in samples for values in stratum]
    between, within = len(each) - len(samples), sum(map(len, each)) - len(each)
    if min(map(len, samples), default=0) < 2 or min(map(len, each)) < 2 or within < 3:
        return Estimate(math.nan, math.nan, math.nan, sum(map(len, each)), "needs 2 teachers and 2 seeds")
    n = len(each) / sum(1 / len(values) for values in each)
    noise = sum(float((deviations(values) ** 2).sum()) for values in each) / within
    means = [np.array([values.mean() for values in stratum]) for stratum in samples]
    signal = sum(float((deviations(row) ** 2).sum()) for row in means) / between
    ratio = n * signal / noise if noise else math.inf
    ends = (ratio / special.fdtri(between, within, share) for share in (TAIL, 1 - TAIL))
    value, low, high = (
        math.sqrt(max(0.0, (found - 1) / n)) for found in (ratio * (within - 2) / within, *ends)
    )
    return Estimate(value, low, high, sum(map(len, each)))


def performance_profile(
    sample: Strata, thresholds: Sequence[float], clusters: Clusters | None = None
) -> pd.DataFrame:
    """Return the share of runs over each threshold, with Clopper and Pearson's exact intervals.

    An interval holds threshold by threshold, not for the whole profile at once. Runs of several strata count
    as one sample, for which the intervals are wider than they need to be. Of runs that depend on each other,
    only as many count as there are clusters.

    Returns:
        threshold, share, low, high, n, reason.
    """
    parts = _finite(sample)
    values = np.concatenate([part.to_numpy() for _, part in sorted(parts.items())] or [np.zeros(0)])
    counted = len(values)
    if clusters is not None:
        counted = len({clusters[run] for part in parts.values() for run in part.index})
    rows: list[list[Any]] = []
    for threshold in thresholds:
        if not len(values):
            rows.append([threshold, math.nan, math.nan, math.nan, 0, "no results"])
            continue
        share = float((values > threshold).mean())
        over, under = share * counted, (1 - share) * counted
        low = float(special.betaincinv(over, under + 1, 1 - TAIL)) if over else 0.0
        high = float(special.betaincinv(over + 1, under, TAIL)) if under else 1.0
        rows.append([threshold, share, low, high, len(values), ""])
    return pd.DataFrame(rows, columns=["threshold", "share", "low", "high", "n", "reason"])


def _margin(parts: Sequence[Floats], freedoms: Sequence[float] | None = None) -> float:
    """Return half the width of Student's interval of the mean over all values of `parts`."""
    n = sum(map(len, parts))
    freedoms = freedoms or [len(part) - 1.0 for part in parts]
    squares = [float((deviations(part) ** 2).sum()) / (len(part) - 1) for part in parts]
    variances = [len(part) / n**2 * square for part, square in zip(parts, squares, strict=True)]
    total = sum(variances)
    if total == 0:
        return 0.0
    shares = (variance**2 / max(freedom, 1.0) for variance, freedom in zip(variances, freedoms, strict=True))
    return float(special.stdtrit(total**2 / sum(shares), TAIL)) * math.sqrt(total)


def _margin_of_clusters(parts: Sequence[Floats], names: Sequence[Hashable], kept: float = 1.0) -> float:
    """Return half the width of Student's interval of the mean over all values of `parts`, by clusters.

    `names` are the clusters of all values, in the same order; `kept` is the share of them that count as
    degrees of freedom.
    """
    residuals = np.concatenate([deviations(part) for part in parts])
    _, places = np.unique(np.array(list(map(str, names))), return_inverse=True)
    sums = np.bincount(places, residuals)
    if len(sums) < 2:
        return math.nan
    error = math.sqrt(len(sums) / (len(sums) - 1) * float(sums @ sums)) / len(residuals)
    return float(special.stdtrit(max(len(sums) * kept - 1, 1.0), TAIL)) * error


def _share_of_wins(first: Floats, second: Floats) -> float:
    """Return the share of pairs in which `first` is greater, ties up to rounding errors counting half."""
    ties = negligible(first - second, np.maximum(np.abs(first), np.abs(second)))
    return float(np.where(ties, 0.5, first > second).mean())


def _newcombe(share: float, n: int, m: int) -> tuple[float, float]:
    """Return the interval of a probability of improvement that was estimated from n times m pairs.

    Its ends are the chances c whose squared distance to `share` is the squared quantile times their variance
    c (1 - c) / (n m) (1 + (mean) ((1 - c) / (2 - c) + c / (1 + c))), mean being (n + m) / 2 - 1. Over their
    denominators that is a polynomial of degree 4, with a root below 0, another above 1 and these two between.
    """
    mean, quantile = (n + m) / 2 - 1, float(special.stdtrit(n + m - 2, TAIL))
    denominators = np.array([2.0, 1.0, -1.0])  # (2 - c) (1 + c), the constant first, as below
    spread = np.convolve([0.0, 1.0, -1.0], denominators + mean * np.array([1.0, 2.0, -2.0]))
    excess = n * m * np.convolve([share**2, -2 * share, 1.0], denominators) - quantile**2 * spread
    _, low, high, _ = np.sort(np.roots(excess[::-1]).real)
    return min(max(float(low), 0.0), share), max(min(float(high), 1.0), share)


def _finite(sample: Strata) -> dict[str, pd.Series]:
    """Return the finite values of each stratum that has any, as floats."""
    finite = {}
    for name, values in sample.items():
        part = values.astype(float)
        known = np.isfinite(part.to_numpy())
        if known.any():
            finite[name] = part if known.all() else part[known]
    return finite
