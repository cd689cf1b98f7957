"""Coverage of confidence intervals by simulation: the rows of ``measured/interval_coverage.csv``."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

from analysis.statistics import stratified
from analysis.statistics.estimates import (
    TRIMMED,
    interquartile_mean_of,
    performance_profile,
    probability_of_improvement,
)

SIZES = (2, 3, 5, 10, 32)
STRATA = (1, 5)
LARGE = 400_000
"""Number of values that represent the population."""

Floats = NDArray[np.float64]
Draw = Callable[[np.random.Generator, float, tuple[int, ...]], Floats]


def normal(rng: np.random.Generator, shift: float, shape: tuple[int, ...]) -> Floats:
    """Return normal values with mean `shift` and deviation 1."""
    return rng.normal(shift, 1.0, shape)


def bounded(rng: np.random.Generator, shift: float, shape: tuple[int, ...]) -> Floats:
    """Return percentages of mastered tasks as on a hard challenge, many of them 0."""
    return np.clip(rng.normal(10.0 + 10.0 * shift, 12.0, shape), 0.0, 100.0)


def bimodal(rng: np.random.Generator, shift: float, shape: tuple[int, ...]) -> Floats:
    """Return percentages of mastered tasks of a student that learns in about half of the runs."""
    learns = rng.random(shape) < 0.5 + 0.1 * shift
    return np.where(learns, rng.normal(80.0, 8.0, shape), rng.normal(5.0, 3.0, shape)).clip(0.0, 100.0)


def coverage(draw: Draw, strata: int, n: int, experiments: int) -> tuple[float, ...]:
    """Return the coverage of intervals of a mean, a difference, and the three estimates of `estimates`.

    Experiments with equal results of all runs, which have no interval, do not count.
    """
    rng = np.random.default_rng([strata, n])
    population, better = draw(rng, 0.0, (LARGE,)), draw(rng, 1.0, (LARGE,))
    middle = float(np.mean(stats.trim_mean(draw(rng, 0.0, (20_000, n * strata)), TRIMMED, axis=-1)))
    ranks = stats.rankdata(np.concatenate([better, population]))[:LARGE].sum()
    chance = (ranks - LARGE * (LARGE + 1) / 2) / LARGE**2
    threshold = float(np.quantile(population, 0.7))
    share = float((population > threshold).mean())
    mean, difference = float(population.mean()), float(better.mean() - population.mean())
    zero = pd.Series(0.0, index=["no", "spread"])
    held, counted = np.zeros(5), np.zeros(5)
    for _ in range(experiments):
        first, second = (
            {
                str(i): pd.Series(values, index=[f"{name}{i}-{k}" for k in range(n)])
                for i, values in enumerate(draw(rng, shift, (strata, n)))
            }
            for name, shift in (("a", 0.0), ("b", 1.0))
        )
        profile = performance_profile(first, [threshold]).iloc[0]
        weights = [1.0] * strata
        alone = stratified([(values, zero) for values in first.values()], weights)
        both = stratified([(second[name], values) for name, values in first.items()], weights)
        middling, better_than = interquartile_mean_of(first), probability_of_improvement(second, first)
        intervals = [
            (alone.low, mean, alone.high),
            (both.low, difference, both.high),
            (middling.low, middle, middling.high),
            (better_than.low, chance, better_than.high),
            (profile["low"], share, profile["high"]),
        ]
        held += [low <= truth <= high for low, truth, high in intervals]
        counted += [math.isfinite(low) for low, _, _ in intervals]
    return tuple(held / counted)


def main() -> None:
    """Print the coverage of all distributions and sizes as CSV."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("--experiments", type=int, default=4_000, help="simulated for each row (%(default)s)")
    experiments = parser.parse_args().experiments
    for draw in (normal, bounded, bimodal):
        for strata in STRATA:
            for n in SIZES:
                shares = (f"{100 * each:.1f}" for each in coverage(draw, strata, n, experiments))
                print(f"{draw.__name__},{strata},{n},{','.join(shares)}", flush=True)


if __name__ == "__main__":
    main()
