"""Statistics of seeds for benchmarks: correlations, signal to noise."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from analysis.statistics.samples import TAIL, Estimate, deviations

Floats = NDArray[np.float64]


def signal_to_noise(strata: Sequence[Mapping[str, ArrayLike]]) -> Estimate:
    """Return the ratio of the standard deviation between teachers to that between seeds.

    With F = n v / s², where v is the mean variance of the teachers' means in a stratum and s² the pooled
    variance of seeds with f degrees of freedom, the squared ratio is (F (f - 2) / f - 1) / n, unbiased until
    it is cut at 0. The interval is exact for normal teachers and seeds, whose F is Fisher's F times 1 + n
    times the squared ratio. For unequal n their harmonic mean is used.

    Args:
        strata: values (n,), one per seed, by teacher; one mapping per task space.
    """
    samples = [[np.asarray(values, float) for values in stratum.values()] for stratum in strata]
    cells = [values for stratum in samples for values in stratum]
    runs = sum(map(len, cells))
    between, within = len(cells) - len(samples), runs - len(cells)
    if min(map(len, samples), default=0) < 2 or min(map(len, cells)) < 2 or within < 3:
        return Estimate(math.nan, math.nan, math.nan, runs, "needs 2 teachers and 2 seeds")
    n = len(cells) / sum(1 / len(values) for values in cells)
    noise = sum(float((deviations(values) ** 2).sum()) for values in cells) / within
    means = [np.array([values.mean() for values in stratum]) for stratum in samples]
    signal = sum(float((deviations(row) ** 2).sum()) for row in means) / between
    ratio = n * signal / noise if noise else math.inf
    ends = (ratio / special.fdtri(between, within, share) for share in (TAIL, 1 - TAIL))
    value, low, high = (math.sqrt(max(0.0, (f - 1) / n)) for f in (ratio * (within - 2) / within, *ends))
    return Estimate(value, low, high, runs)


def seed_correlation(tables: Sequence[Floats]) -> Estimate:
    """Return the intraclass correlation of runs with a common seed, with its F interval.

    This is Shrout and Fleiss' (1979) ICC(3,1), the share of seeds in the variance of runs, pooled over tables
    after division of each teacher's values by their standard deviation.

    Args:
        tables: values of runs, seeds by teachers (n, k), at least (2, 2), with the same k in all tables.

    Raises:
        ValueError: if the tables differ in their number of teachers, or there is none.
    """
    sizes = {table.shape[1] for table in tables}
    if len(sizes) != 1:
        raise ValueError(f"tables of {sorted(sizes)} teachers: expected one number, the same in all")
    (k,) = sizes
    between = within = 0.0
    for table in tables:
        residuals = deviations(table.T).T
        spreads = np.sqrt((residuals**2).sum(axis=0) / (len(table) - 1))
        scaled = residuals / np.where(spreads > 0, spreads, 1.0)
        seeds = scaled.mean(axis=1, keepdims=True)
        between += k * float((seeds**2).sum())
        within += float(((scaled - seeds) ** 2).sum())
    of_seeds = sum(len(table) - 1 for table in tables)
    of_rest = of_seeds * (k - 1)
    ratio = (between / of_seeds) / (within / of_rest) if within else math.inf
    low = ratio / float(special.fdtri(of_seeds, of_rest, TAIL))
    high = ratio * float(special.fdtri(of_rest, of_seeds, TAIL))
    value, low, high = ((f - 1) / (f + k - 1) if math.isfinite(f) else 1.0 for f in (ratio, low, high))
    return Estimate(value, low, high, sum(map(len, tables)))


def least_correlation(n: int) -> float:
    """Return the least correlation at which pairs of `n` runs have a narrower interval than Welch's test.

    0.58 with 3 runs, 0.31 with 5, 0.14 with 10: pairing reduces the variance of a difference, and halves the
    degrees of freedom.

    Raises:
        ValueError: if there are fewer than 2 runs.
    """
    if n < 2:
        raise ValueError(f"n = {n}: expected at least 2 runs")
    unpaired, pairs = (float(special.stdtrit(freedom, TAIL)) for freedom in (2 * n - 2, n - 1))
    return 1 - (unpaired / pairs) ** 2


def pairing_helps(correlation: Estimate, n: int) -> bool:
    """Return True if the interval of the correlation is over `least_correlation`.

    The test is biased unless the correlation is estimated from other runs than the tested ones.
    """
    return correlation.low > least_correlation(n)
