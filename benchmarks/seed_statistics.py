"""Statistics of seeds and of effects of teachers for benchmarks: correlations, signal to noise."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from analysis.statistics.samples import TAIL, Estimate, deviations

CORRELATION_DRAWS = 20_000
"""Number of random draws behind the interval of a correlation."""

LEAST_FREEDOM = 4
"""Least degrees of freedom of both covariances; with fewer, draws have no second moments."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class EffectCorrelation(Estimate):
    """A correlation of true effects with its 95 % interval.

    Attributes:
        observed: Pearson's correlation of the observed means, less the mean of their space.
        left_out: share of draws excluded from the interval for want of a positive variance of true effects.
    """

    observed: float = math.nan
    left_out: float = math.nan


def effect_correlation(spaces: Sequence[Mapping[Any, ArrayLike]]) -> EffectCorrelation:
    """Return the correlation between two measures of the true effects of teachers.

    The correlation of observed means is biased: upwards since both measures of a run share its luck, and
    downwards since means of few seeds are noisy. Here the covariance between seeds is subtracted.

    In each of C spaces teachers have n seeds; an effect is a teacher's mean less that of its space. With B,
    the 2 x 2 matrix of mean squares and products between teachers (f degrees of freedom), and W, that between
    seeds of a cell (g), the covariance of true effects is (B - W) / n. The estimate is its correlation,
    clipped to [-1, 1], or NaN without a positive variance.

    The interval is a generalised one for normal effects and seeds: B and W are replaced by f B^½ Q^-1 B^½ and
    g W^½ R^-1 W^½, Q and R Wishart-distributed with f and g degrees of freedom; the interval has the middle
    95 % of the correlations of these. Its coverage is simulated in ``benchmarks/agreement_coverage.py``.

    Args:
        spaces: values (n, 2), a row per seed and a column per measure, by teacher; one mapping per space.
            For unequal n their harmonic mean is used.
    """
    samples = [[np.asarray(values, float) for values in space.values()] for space in spaces]
    cells = [values for space in samples for values in space]
    runs = sum(map(len, cells))
    freedom, noise_freedom = len(cells) - len(samples), runs - len(cells)
    if min(map(len, samples), default=0) < 2 or min(freedom, noise_freedom) < LEAST_FREEDOM:
        reason = f"needs {LEAST_FREEDOM} degrees of freedom"
        return EffectCorrelation(math.nan, math.nan, math.nan, runs, reason)
    n = len(cells) / sum(1 / len(values) for values in cells)
    means = [np.array([values.mean(axis=0) for values in space]) for space in samples]
    effects = np.concatenate([matrix - matrix.mean(axis=0) for matrix in means])
    residuals = np.concatenate([values - values.mean(axis=0) for values in cells])
    between, within = n * effects.T @ effects / freedom, residuals.T @ residuals / noise_freedom
    value, observed = (float(_correlations(matrix[None])[0]) for matrix in (between - within, between))
    rng = np.random.default_rng(0)
    drawn = _correlations(_drawn(between, freedom, rng) - _drawn(within, noise_freedom, rng))
    usable = drawn[~np.isnan(drawn)]
    left_out = 1 - len(usable) / CORRELATION_DRAWS
    if math.isnan(value) or left_out > 0.5:
        reason = "teachers differ by no more than chance"
        return EffectCorrelation(value, math.nan, math.nan, runs, reason, observed, left_out)
    low, high = np.quantile(usable, (1 - TAIL, TAIL))
    return EffectCorrelation(value, float(low), float(high), runs, "", observed, left_out)


def _drawn(covariance: Floats, freedom: int, rng: np.random.Generator) -> Floats:
    """Return draws (n, 2, 2) of a true covariance, given its estimate.

    Wishart matrices are L L' with Bartlett's lower triangular L.
    """
    values, vectors = np.linalg.eigh(covariance)
    root = (vectors * np.sqrt(np.clip(values, 0.0, None))) @ vectors.T
    first, second = (np.sqrt(rng.chisquare(freedom - column, CORRELATION_DRAWS)) for column in (0, 1))
    inverse = np.zeros((CORRELATION_DRAWS, 2, 2))
    inverse[:, 0, 0], inverse[:, 1, 1] = 1 / first, 1 / second
    inverse[:, 1, 0] = -rng.standard_normal(CORRELATION_DRAWS) / (first * second)
    half = root @ inverse.transpose(0, 2, 1)
    return np.asarray(freedom * half @ half.transpose(0, 2, 1))


def _correlations(covariances: Floats) -> Floats:
    """Return the correlation of each matrix (m, 2, 2), clipped to [-1, 1]; NaN without positive variances."""
    first, second, both = covariances[:, 0, 0], covariances[:, 1, 1], covariances[:, 0, 1]
    positive = (first > 0) & (second > 0)
    product = np.where(positive, first * second, 1.0)
    return np.where(positive, np.clip(both / np.sqrt(product), -1.0, 1.0), np.nan)


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

    Shrout and Fleiss' (1979) ICC(3,1), the share of seeds in the variance of runs, pooled over tables after
    each teacher's values are divided by their standard deviation.

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

    The correlation must be estimated from other runs than those to be tested, or the test is biased.
    """
    return correlation.low > least_correlation(n)
