"""Pairs of runs of the same seed: their test, their correlation, and the rule on when they are used."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.statistics.comparisons import ALL_EQUAL, Comparison, Method, t_test
from analysis.statistics.permutations import sign_flip_p
from analysis.statistics.samples import CONFIDENCE, describe

TAIL = (1 + CONFIDENCE) / 2

FEW_PAIRS = "fewer than 2 seeds in common"
"""Why two samples are not tested that are to be paired."""


@dataclass(frozen=True)
class Correlation:
    """How much of the variance of runs is that of their seeds, whatever the teacher.

    Attributes:
        value: intraclass correlation, at most 1; 0 where a seed says nothing about a run.
        low: lower end of its 95 % interval.
        high: upper end of it.
        tables: how many tables of seeds by teachers it is of.
    """

    value: float
    low: float
    high: float
    tables: int


def paired(sample: pd.Series, reference: pd.Series) -> Comparison:
    """Compares the means of two samples whose values belong together in pairs, by Student's t-test.

    Where all differences are equal, p is that of the sign-flip test, and the interval is missing; where all
    are 0, nothing is tested.

    Args:
        sample: one value a seed, indexed by seed.
        reference: likewise; seeds that only one of them has do not count.

    Returns:
        Its n and reference_n are the number of pairs.
    """
    differences = (sample - reference).dropna()
    found = describe(differences)
    if found.n < 2:
        reason = FEW_PAIRS if min(sample.count(), reference.count()) > 1 else "needs 2 seeds"
        return Comparison(found.n, found.n, found.mean, reason=reason)
    if found.std == found.mean == 0:
        return Comparison(found.n, found.n, found.mean, reason=ALL_EQUAL)
    if found.std == 0:
        p = sign_flip_p(differences)
        return Comparison(found.n, found.n, found.mean, p=p, method=Method.SIGN_FLIP)
    return t_test(found.n, found.n, found.mean, found.standard_error, found.n - 1, Method.PAIRED)


def paired_strata(
    pairs: Sequence[tuple[pd.Series, pd.Series]], weights: Sequence[float], seeds: Mapping[Any, Hashable]
) -> Comparison:
    """Compares the means of two groups over strata that both have, as pairs of runs with the same seed.

    A pair is a seed that both groups have in every stratum, and its difference the weighted mean over strata:
    so what its runs of several strata have in common, too, does not count as several results.

    Args:
        pairs: samples of both groups in each stratum, one value a run, indexed by run id.
        weights: of the strata; they need not add up to 1.
        seeds: of all runs by id.
    """
    if not pairs:
        return Comparison(0, 0, math.nan, reason="nothing in common")
    groups = list(zip(*pairs, strict=True))
    first, second = (seed_means(group, weights, seeds) for group in groups)
    ours, theirs = (set().union(*(sample.index for sample in group)) for group in groups)
    if ours & theirs:
        difference = float(first.mean() - second.mean())
        return Comparison(len(first), len(second), difference, reason="same runs")
    return paired(first, second)


def seed_means(
    samples: Sequence[pd.Series], weights: Sequence[float], seeds: Mapping[Any, Hashable]
) -> pd.Series:
    """Returns the weighted mean over strata of each seed that all of them have, indexed by seed.

    Args:
        samples: of each stratum, one value a run, indexed by run id; several of a seed count as their mean.
        weights: of the strata; they need not add up to 1.
        seeds: of all runs by id.
    """
    parts = [_of_seeds(sample, seeds) for sample in samples]
    common = [seed for seed in parts[0] if all(seed in part for part in parts)]
    values = np.array([[part[seed] for seed in common] for part in parts])
    return pd.Series(np.asarray(weights, float) @ values / sum(weights), index=common, dtype=float)


def _of_seeds(sample: pd.Series, seeds: Mapping[Any, Hashable]) -> dict[Hashable, float]:
    """Returns the mean of the finite values of each seed."""
    values: dict[Hashable, list[float]] = {}
    for run, value in zip(sample.index, sample.to_numpy(float), strict=True):
        if math.isfinite(value):
            values.setdefault(seeds[run], []).append(value)
    return {seed: sum(mine) / len(mine) for seed, mine in values.items()}


def seed_correlation(tables: Sequence[NDArray[np.float64]]) -> Correlation:
    """Returns the intraclass correlation of runs that have a seed in common, with its F interval.

    Shrout and Fleiss' (1979) ICC(3,1), pooled over tables: sums of squares of seeds and of residuals add up,
    after each teacher's values are divided by their standard deviation.

    Args:
        tables: values of runs, seeds by teachers (n, k), at least (2, 2); k is the same in all.

    Raises:
        ValueError: the tables differ in their number of teachers, or there is none.
    """
    from scipy import special

    sizes = {table.shape[1] for table in tables}
    if len(sizes) != 1:
        raise ValueError(f"tables of {sorted(sizes)} teachers: expected one number, the same in all")
    (k,) = sizes
    between = within = 0.0
    for table in tables:
        spreads = table.std(axis=0, ddof=1)
        scaled = (table - table.mean(axis=0)) / np.where(spreads > 0, spreads, 1.0)
        seeds = scaled.mean(axis=1, keepdims=True)
        between += k * float((seeds**2).sum())
        within += float(((scaled - seeds) ** 2).sum())
    of_seeds = sum(len(table) - 1 for table in tables)
    of_rest = of_seeds * (k - 1)
    ratio = (between / of_seeds) / (within / of_rest) if within else math.inf
    low = ratio / float(special.fdtri(of_seeds, of_rest, TAIL))
    high = ratio * float(special.fdtri(of_rest, of_seeds, TAIL))
    value, low, high = ((f - 1) / (f + k - 1) if math.isfinite(f) else 1.0 for f in (ratio, low, high))
    return Correlation(value, low, high, len(tables))


def least_correlation(n: int) -> float:
    """Returns the correlation over which pairs of `n` runs have a narrower interval than Welch's test.

    The variance of a difference falls by the correlation, while Student's quantile grows, since n - 1 degrees
    of freedom are left of 2 n - 2.

    Raises:
        ValueError: fewer than 2 runs.
    """
    if n < 2:
        raise ValueError(f"n = {n}: expected at least 2 runs")
    from scipy import special

    unpaired, pairs = (float(special.stdtrit(freedom, TAIL)) for freedom in (2 * n - 2, n - 1))
    return 1 - (unpaired / pairs) ** 2


def pairing_helps(correlation: Correlation, n: int) -> bool:
    """Returns the rule: runs are paired where the interval of their correlation is over what `n` need.

    It is held against released results of other campaigns, never against those that are to be tested: to
    choose the test by its own data finds differences that are not there.
    """
    return correlation.low > least_correlation(n)
