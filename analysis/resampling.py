"""Estimates that do without normal samples, with bootstrap intervals (Agarwal et al., 2021).

A sample is made of strata, such as the bodies of a pool or the challenges of an environment: a mapping from
the name of each to its values (n,), one a run, indexed by run id. Resampling draws runs anew within each
stratum, so that no stratum gains or loses weight.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from analysis.statistics import CONFIDENCE

RESAMPLES = 2_000
"""Bootstrap samples of an interval: its ends then move by a few hundredths of its width between draws."""

BATCH = 250
"""Bootstrap samples that are in memory at once."""

Strata: TypeAlias = Mapping[str, pd.Series]


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % percentile bootstrap interval.

    Attributes:
        value: of the sample itself; NaN where it has none.
        low: lower end of the interval; NaN where there is none.
        high: upper end of it.
        n: runs of the sample, of both for a comparison.
        reason: why there is no interval; empty when there is one.
    """

    value: float
    low: float
    high: float
    n: int
    reason: str = ""


def interquartile_mean(values: ArrayLike, axis: int = -1) -> Any:
    """Returns the mean of the middle half: a quarter of the values, rounded down, is cut at each end."""
    return stats.trim_mean(np.asarray(values, dtype=float), 0.25, axis=axis)


def bootstrap_interquartile_mean(
    sample: Strata, rng: np.random.Generator, resamples: int = RESAMPLES
) -> Estimate:
    """Returns the interquartile mean of all runs of all strata together, each run with equal weight.

    Args:
        sample: the strata.
        rng: drawn from.
        resamples: of the bootstrap.
    """

    def statistic(*parts: NDArray[np.float64], axis: int = -1) -> Any:
        return interquartile_mean(np.concatenate(parts, axis=axis), axis)

    return _estimate(_parts(sample), statistic, rng, resamples)


def probability_of_improvement(
    first: Strata, second: Strata, rng: np.random.Generator, resamples: int = RESAMPLES
) -> Estimate:
    """Returns the probability that a run of `first` beats one of `second`, ties counting half.

    It is Mann and Whitney's U over the number of pairs, averaged over strata with equal weight. There is
    none for samples that share a run, or that are not of the same strata.

    Args:
        first: strata of one group.
        second: strata of the other, of the same names.
        rng: drawn from.
        resamples: of the bootstrap.
    """
    ours, theirs = _finite(first), _finite(second)
    n = sum(map(len, (*ours.values(), *theirs.values())))
    if {run for part in first.values() for run in part.index} & {
        run for part in second.values() for run in part.index
    }:
        return Estimate(math.nan, math.nan, math.nan, n, "same runs")
    if set(ours) != set(theirs):
        return Estimate(math.nan, math.nan, math.nan, n, "other strata")
    names = sorted(ours)

    def statistic(*parts: NDArray[np.float64], axis: int = -1) -> Any:
        pairs = zip(parts[: len(names)], parts[len(names) :], strict=True)
        return np.mean([_superiority(*pair, axis=axis) for pair in pairs], axis=0)

    parts = [ours[name].to_numpy() for name in names] + [theirs[name].to_numpy() for name in names]
    return _estimate(parts, statistic, rng, resamples)


def performance_profile(
    sample: Strata, thresholds: Sequence[float], rng: np.random.Generator, resamples: int = RESAMPLES
) -> pd.DataFrame:
    """Returns the share of runs over each threshold, with a band that holds threshold by threshold.

    All thresholds are judged by the same bootstrap samples, so that the band falls as the profile does.

    Args:
        sample: the strata.
        thresholds: values of the measure, in any order.
        rng: drawn from.
        resamples: of the bootstrap.

    Returns:
        threshold, share, low, high, n, reason.
    """
    parts, rows, seed = _parts(sample), [], int(rng.integers(2**63))
    for threshold in thresholds:

        def statistic(*drawn: NDArray[np.float64], axis: int = -1, over: float = threshold) -> Any:
            return np.mean(np.concatenate(drawn, axis=axis) > over, axis=axis)

        estimate = vars(_estimate(parts, statistic, np.random.default_rng(seed), resamples))
        rows.append({"threshold": threshold, "share": estimate.pop("value")} | estimate)
    return pd.DataFrame(rows, columns=["threshold", "share", "low", "high", "n", "reason"])


def _superiority(values: NDArray[np.float64], others: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Returns the share of pairs in which values (..., n) beat others (..., m), ties counting half."""
    ours = np.moveaxis(values, axis, -1)[..., :, None]
    theirs = np.moveaxis(others, axis, -1)[..., None, :]
    share: NDArray[np.float64] = ((ours > theirs) + 0.5 * (ours == theirs)).mean(axis=(-2, -1))
    return share


def _finite(sample: Strata) -> dict[str, pd.Series]:
    """Returns the strata that have finite values, those only, as floats."""
    floats = {name: part.astype(float) for name, part in sample.items()}
    kept = {name: part[np.isfinite(part)] for name, part in floats.items()}
    return {name: part for name, part in kept.items() if len(part)}


def _parts(sample: Strata) -> list[NDArray[np.float64]]:
    return [part.to_numpy() for _, part in sorted(_finite(sample).items())]


def _estimate(
    parts: list[NDArray[np.float64]], statistic: Callable[..., Any], rng: np.random.Generator, resamples: int
) -> Estimate:
    n = sum(map(len, parts))
    if not n:
        return Estimate(math.nan, math.nan, math.nan, 0, "no results")
    value = float(statistic(*parts))
    if min(map(len, parts)) < 2:
        return Estimate(value, math.nan, math.nan, n, "needs 2 seeds")
    interval = stats.bootstrap(
        parts,
        statistic,
        n_resamples=resamples,
        batch=BATCH,
        vectorized=True,
        confidence_level=CONFIDENCE,
        method="percentile",
        rng=rng,
    ).confidence_interval
    return Estimate(value, float(interval.low), float(interval.high), n)
