"""Simulated coverage of intervals of `effect_correlation`: ``measured/agreement_coverage.csv``.

Effects of teachers and of seeds are normally distributed. Both measures of a run have the same signal to
noise, and their seed effects have a correlation of a half.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from analysis.comparisons.budgets import effect_correlation

SPACES = (2, 4)
TEACHERS, SEEDS = 10, (3, 5)
SIGNALS = (1.0, 2.0)
TRUE = (0.0, 0.5, 0.84, 0.95)
SHARED_LUCK = 0.5


def simulated(
    rng: np.random.Generator, spaces: int, seeds: int, signal: float, true: float
) -> list[dict[int, np.ndarray]]:
    """Return simulated results (seeds, 2) by space and teacher, with a given correlation of true effects."""
    effects = signal * rng.multivariate_normal([0, 0], [[1, true], [true, 1]], (spaces, TEACHERS))
    luck = rng.multivariate_normal([0, 0], [[1, SHARED_LUCK], [SHARED_LUCK, 1]], (spaces, TEACHERS, seeds))
    return [dict(enumerate(space)) for space in effects[:, :, None] + luck]


def coverage(experiments: int) -> pd.DataFrame:
    """Return the mean estimate, and the coverage and median length of intervals, by design."""
    rows = []
    for spaces, seeds, signal, true in itertools.product(SPACES, SEEDS, SIGNALS, TRUE):
        rng = np.random.default_rng([spaces, seeds, int(10 * signal), int(100 * true)])
        estimates = [
            effect_correlation(simulated(rng, spaces, seeds, signal, true)) for _ in range(experiments)
        ]
        decided = [estimate for estimate in estimates if not estimate.reason]
        holds = [estimate.low <= true <= estimate.high for estimate in decided]
        lengths = [estimate.high - estimate.low for estimate in decided]
        observed = float(np.mean([estimate.observed for estimate in estimates]))
        value = float(np.nanmean([estimate.value for estimate in estimates]))
        numbers = (
            f"{observed:.2f}",
            f"{value:.2f}",
            f"{100 * np.mean(holds):.1f}",
            f"{np.median(lengths):.2f}",
        )
        rows.append((spaces, seeds, f"{signal:g}", f"{true:g}", *numbers))
    head = [
        "spaces",
        "seeds",
        "signal to noise",
        "true",
        "observed",
        "corrected",
        "holds, %",
        "median length",
    ]
    return pd.DataFrame(rows, columns=head)


def print_coverage(
    coverage: Callable[[int], pd.DataFrame], description: str | None, experiments: int
) -> None:
    """Print a table of simulated coverage as CSV, and write it to the file of ``--output``.

    Args:
        coverage: function that returns the rows, given the number of experiments of each.
        description: description of the script for ``--help``.
        experiments: default number of experiments.
    """
    parser = argparse.ArgumentParser(allow_abbrev=False, description=description)
    parser.add_argument(
        "--experiments", type=int, default=experiments, help="simulated experiments of each row"
    )
    parser.add_argument("--output", type=Path, help="CSV file")
    options = parser.parse_args()
    table = coverage(options.experiments)
    print(table.to_csv(index=False))
    if options.output:
        table.to_csv(options.output, index=False)


if __name__ == "__main__":
    print_coverage(coverage, __doc__, 500)
