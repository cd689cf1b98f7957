"""Verdicts on claims: the paper's by its own tables, and simulated statements with known effects.

    python benchmarks/claim_standings.py

Prints the rows of ``measured/paper_claims.csv`` and ``measured/statements_decided.csv``.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Callable

import numpy as np
import pandas as pd

from analysis.claims.judging import judge
from analysis.claims.sources import PaperSource
from analysis.statistics import Comparison, stratified
from analysis.statistics.samples import Standing, equivalent, greater

DIFFERENCES = (0.0, 2.0, 10.0, 20.0)
"""True differences of two teachers, in points of mastered tasks."""

SIZES = (3, 5, 10, 32)
CHALLENGES = (1, 6)

SPREAD = 10.0
"""Standard deviation of runs, in points."""

STATEMENTS: dict[str, Callable[[Comparison], Standing]] = {
    "better": lambda test: greater(test.low, test.high),
    "alike": lambda test: equivalent(test.low, test.high),
}


def standings(difference: float, seeds: int, challenges: int, experiments: int) -> dict[str, list[float]]:
    """Return the % of experiments that support, leave undecided and refute each statement."""
    rng = np.random.default_rng([int(difference), seeds, challenges])
    order = [Standing.SUPPORTED, Standing.UNDECIDED, Standing.REFUTED]
    counts = {name: np.zeros(3) for name in STATEMENTS}
    for _ in range(experiments):
        values = rng.normal(0.0, SPREAD, (challenges, 2, seeds))
        pairs = [(_sample(mine + difference, "a"), _sample(theirs, "b")) for mine, theirs in values]
        test = stratified(pairs, [1.0] * challenges)
        for name, standing in STATEMENTS.items():
            counts[name][order.index(standing(test))] += 1
    return {name: list(100 * count / experiments) for name, count in counts.items()}


def _sample(values: np.ndarray, prefix: str) -> pd.Series:
    return pd.Series(values, index=[f"{prefix}{i}" for i in range(len(values))])


def of_the_paper() -> list[tuple[str, str, str]]:
    """Return the paper's claims with the verdicts of the paper's own tables."""
    return [(each.claim.text, each.standing, each.describe()) for each in judge(PaperSource())]


def main() -> None:
    """Print the verdicts on the paper's claims, and the shares of verdicts on simulated statements."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("--experiments", type=int, default=2_000, help="simulated for each row (%(default)s)")
    experiments = parser.parse_args().experiments
    csv.writer(sys.stdout, lineterminator="\n").writerows(of_the_paper())
    for challenges in CHALLENGES:
        for difference in DIFFERENCES:
            for seeds in SIZES:
                found = standings(difference, seeds, challenges, experiments)
                shares = (" / ".join(f"{share:.0f}" for share in found[name]) for name in STATEMENTS)
                print(f"{challenges},{difference:.0f},{seeds},{','.join(shares)}", flush=True)


if __name__ == "__main__":
    main()
