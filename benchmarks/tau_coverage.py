"""Simulated coverage of the bootstrap interval of Kendall's tau: ``measured/tau_coverage.csv``.

Effects of teachers and of seeds are normally distributed; the side of the paper has its 32 seeds.
"""

from __future__ import annotations

import itertools

import numpy as np
import pandas as pd
from agreement_coverage import print_coverage

from analysis.claims.agreement import draws_of_entries, draws_of_runs, kendall, tau_interval
from analysis.statistics import describe

CHALLENGES, TEACHERS, PAPERS = 6, 8, 32
SEEDS = (3, 5, 10)
SIGNALS = (1.0, 2.0)
CORRELATIONS = (0.0, 0.7, 1.0)
"""Correlations of the true effects of both sides."""

REPEATS = 400
"""Number of simulated results for the mean tau of other runs."""


class Truth:
    """True effects (challenges, teachers) of both sides of a comparison, and simulated results."""

    def __init__(self, rng: np.random.Generator, seeds: int, signal: float, correlation: float) -> None:
        self.rng, self.seeds = rng, seeds
        self.mine = signal * rng.standard_normal((CHALLENGES, TEACHERS))
        others = signal * rng.standard_normal((CHALLENGES, TEACHERS))
        self.theirs = correlation * self.mine + np.sqrt(1 - correlation**2) * others

    def results(self) -> tuple[np.ndarray, np.ndarray]:
        """Return simulated results (challenges, teachers, seeds) of both sides."""
        sides = ((self.mine, self.seeds), (self.theirs, PAPERS))
        found = (self.rng.normal(effects[..., None], 1.0, (*effects.shape, n)) for effects, n in sides)
        return next(found), next(found)

    def interval(self) -> tuple[float, float]:
        """Return the interval of the mean tau for one simulated result."""
        mine, theirs = self.results()
        draws = [
            kendall(
                np.stack([draws_of_runs([pd.Series(runs)], self.rng) for runs in ours], axis=-1),
                np.stack([draws_of_entries([describe(runs)], self.rng) for runs in papers], axis=-1),
            )
            for ours, papers in zip(mine, theirs, strict=True)
        ]
        return tau_interval(tau(mine, theirs), np.mean(draws, axis=0))


def tau(mine: np.ndarray, theirs: np.ndarray) -> float:
    """Return the mean tau over challenges."""
    return float(kendall(mine.mean(axis=-1), theirs.mean(axis=-1)).mean())


def coverage(experiments: int) -> pd.DataFrame:
    """Return the share of intervals that cover the tau of other runs, and of the true means, by design."""
    rows = []
    for seeds, signal, correlation in itertools.product(SEEDS, SIGNALS, CORRELATIONS):
        rng = np.random.default_rng([seeds, int(10 * signal), int(10 * correlation)])
        held, lengths, taus = [], [], []
        for _ in range(experiments):
            truth = Truth(rng, seeds, signal, correlation)
            expected = float(np.mean([tau(*truth.results()) for _ in range(REPEATS)]))
            means = float(kendall(truth.mine, truth.theirs).mean())
            low, high = truth.interval()
            held.append((low <= expected <= high, low <= means <= high))
            lengths.append(high - low)
            taus.append((expected, means))
        numbers = (
            *(f"{value:.2f}" for value in np.mean(taus, axis=0)[::-1]),
            *(f"{100 * share:.0f}" for share in np.mean(held, axis=0)),
            f"{np.median(lengths):.2f}",
        )
        rows.append((seeds, f"{signal:g}", *numbers))
    head = ["seeds", "signal to noise", "tau of true means", "of runs, on average"]
    head += ["holds the latter, %", "holds the former, %", "median length"]
    return pd.DataFrame(rows, columns=head)


if __name__ == "__main__":
    print_coverage(coverage, __doc__, 200)
