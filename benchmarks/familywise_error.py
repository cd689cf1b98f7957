"""Tests over challenges on a release: numbers of decided pairs, and familywise error rates.

    python benchmarks/familywise_error.py

Prints the rows of ``measured/pairs_decided.csv`` and ``measured/false_findings.csv``. Simulated runs are the
release's runs less the means of their cells (a teacher, challenge and body), drawn with replacement within
cells, which preserves the spread and skew of every cell.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import special

from analysis.baselines.catalogue import find_baseline
from analysis.measures.pooling import runs_after
from analysis.measures.tested import MEASURES
from analysis.statistics import SIGNIFICANCE, Scale, holm, simultaneous_intervals
from analysis.statistics.tests import LEAST_VARIANCE_SHARE

SIZES = (3, 5, 10)
PERMUTATIONS = 9_999
TAIL = 1 - SIGNIFICANCE / 2

Floats = NDArray[np.float64]


class Release(NamedTuple):
    """Results of teachers with all seeds on all challenges.

    Attributes:
        values: percentages of a measure (cells, teachers, seeds); cells are challenges and bodies.
        weights: weights of cells (cells,), with sum 1 and equal for challenges.
        random: index of Random among the teachers.
    """

    values: Floats
    weights: Floats
    random: int


class Tests(NamedTuple):
    """Welch-Satterthwaite tests of all pairs of teachers over cells (pairs,)."""

    difference: Floats
    error: Floats
    freedom: Floats

    @property
    def p(self) -> Floats:
        """Two-sided p-values."""
        return np.asarray(2 * special.stdtr(self.freedom, -np.abs(self.difference / self.error)), np.float64)


class Families(NamedTuple):
    """Adjusted p-values of two families of tests: all pairs of core teachers, and pairs with Random."""

    pairs: Floats
    random: Floats


def released(runs: pd.DataFrame, measure: str) -> Release:
    """Return the results of a release in a measure, from rows of `runs_after`."""
    table = runs.pivot_table(index=["challenge", "embodiment"], columns=["teacher", "seed"], values=measure)
    teachers = list(table.columns.unique("teacher"))
    challenges = table.index.get_level_values("challenge").to_series().reset_index(drop=True)
    weights = 1 / challenges.groupby(challenges).transform("size").to_numpy(float)
    values = table.to_numpy(float).reshape(len(table), len(teachers), -1)
    return Release(values, weights / weights.sum(), teachers.index("random"))


def on_scale(values: Floats, scale: Scale) -> Floats:
    """Convert percentages of any shape to a scale."""
    return scale.of(pd.Series(values.ravel())).to_numpy(float).reshape(values.shape)


def welch(values: Floats, weights: Floats, least: float = 0.0) -> Tests:
    """Return the Welch-Satterthwaite tests of all pairs (..., pairs) over cells.

    Args:
        values: results of runs (..., cells, teachers, seeds).
        weights: weights of the cells (cells,).
        least: least variance, as a share of the mean variance of a cell's teachers.
    """
    first, second = np.triu_indices(values.shape[-2], 1)
    n = values.shape[-1]
    means = np.einsum("c,...ct->...t", weights, values.mean(-1))
    parts = weights[:, None] ** 2 * values.var(-1, ddof=1) / n
    own, squares = parts.sum(-2), (parts**2).sum(-2) / (n - 1)
    variance = own[..., first] + own[..., second]
    errors = np.maximum(parts, least * parts.mean(-1, keepdims=True)).sum(-2)
    return Tests(
        means[..., first] - means[..., second],
        np.sqrt(errors[..., first] + errors[..., second]),
        variance**2 / (squares[..., first] + squares[..., second]),
    )


def by_permutation(values: Floats, release: Release) -> Families:
    """Return step-down max-t p-values (Westfall and Young, 1993), permuting runs within cells."""
    cells, teachers, n = values.shape
    order = np.argsort(np.random.default_rng(0).random((PERMUTATIONS, cells, teachers * n)), axis=-1)
    shuffled = np.take_along_axis(values.reshape(1, cells, -1), order, -1).reshape(-1, cells, teachers, n)
    found, drawn = (
        np.abs(tests.difference / tests.error)
        for tests in (welch(each, release.weights) for each in (values, shuffled))
    )
    mine = _of_random(release)
    return Families(_step_down(found, drawn), _step_down(found[mine], drawn[:, mine]))


def _step_down(found: Floats, drawn: Floats) -> Floats:
    order = np.argsort(found)
    largest = np.maximum.accumulate(drawn[:, order], axis=1)
    shares = (1 + (largest >= found[order]).sum(axis=0)) / (1 + len(drawn))
    adjusted = np.empty(len(found))
    adjusted[order] = np.maximum.accumulate(shares[::-1])[::-1]
    return adjusted


def by_holm(values: Floats, release: Release, least: float = 0.0) -> Families:
    """Return p-values of Welch-Satterthwaite tests with Holm's correction."""
    p = welch(values, release.weights, least).p
    return Families(holm(p), holm(p[_of_random(release)]))


def _of_random(release: Release) -> NDArray[np.bool_]:
    first, second = np.triu_indices(release.values.shape[1], 1)
    return np.asarray((first == release.random) | (second == release.random))


METHODS: dict[str, Callable[[Floats, Release], Families]] = {
    "Welch": by_holm,
    "least variance": partial(by_holm, least=LEAST_VARIANCE_SHARE),
    "max-t permutation": by_permutation,
}


def simulated(release: Release, seeds: int, experiments: int, *, half: bool) -> list[str]:
    """Return the % of experiments with a false finding, and with all true differences in the intervals.

    Families are all pairs, pairs with Random, and pairs with a newcomer (the last teacher), whose tests use
    the least variances of the other teachers.

    Args:
        release: runs whose residuals are drawn.
        seeds: number of runs in each cell.
        experiments: number of simulated releases.
        half: True if every second teacher keeps its means; else all are equal.
    """
    rng = np.random.default_rng([seeds, half])
    n, teachers = release.values.shape[-1], release.values.shape[1]
    means = release.values.mean(-1, keepdims=True)
    residuals = (release.values - means) * np.sqrt(n / (n - 1))
    others = np.arange(teachers) % 2 == (release.random + 1) % 2
    shift = np.where(others[:, None] & half, means - means[:, ~others].mean(axis=1, keepdims=True), 0.0)
    first, second = np.triu_indices(teachers, 1)
    levels = release.weights @ shift[..., 0]
    true = levels[first] - levels[second]
    newest = (first == teachers - 1) | (second == teachers - 1)
    families = {"pairs": np.ones_like(newest), "random": _of_random(release), "newcomer": newest}
    counts = {name: np.zeros(3) for name in families}
    for _ in range(experiments):
        drawn = rng.integers(0, n, (*means.shape[:2], seeds))
        runs = shift + np.take_along_axis(residuals, drawn, -1)
        for name, mine in families.items():
            tests = Tests(*(each[mine] for each in welch(runs, release.weights, LEAST_VARIANCE_SHARE)))
            adjusted, margin = holm(tests.p), special.stdtrit(tests.freedom, TAIL) * tests.error
            low, high = simultaneous_intervals(
                tests.difference,
                tests.difference - margin,
                tests.difference + margin,
                tests.freedom,
                adjusted,
            )
            found, equal = adjusted < SIGNIFICANCE, true[mine] == 0
            held = (low <= true[mine]) & (true[mine] <= high)
            counts[name] += (found & equal).any(), (found & ~equal).sum(), held.all()
    shown = []
    for wrong, right, held in counts.values():
        more = f" ({right / experiments:.1f})" if half else ""
        shown += [f"{100 * wrong / experiments:.1f}{more}", f"{100 * held / experiments:.1f}"]
    return shown


def main() -> None:
    """Print the decided pairs, false findings and coverage of all tests."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("--experiments", type=int, default=1_000, help="simulated for each row (%(default)s)")
    parser.add_argument("--release", default="lite-2", help="release whose runs are taken (%(default)s)")
    given = parser.parse_args()
    frames = find_baseline(given.release).frames()
    runs = runs_after(frames, training=False)
    core = frames.cells.loc[frames.cells["core"], "run_id"]
    runs = runs[runs["run_id"].isin(core)]
    for measure, scale in itertools.product(MEASURES, Scale):
        release = released(runs, measure)
        found = [method(on_scale(release.values, scale), release) for method in METHODS.values()]
        counts = ((p < SIGNIFICANCE).sum() for p in (*(f.pairs for f in found), *(f.random for f in found)))
        print(f"`{given.release}`,`{measure}`,{scale},{','.join(map(str, counts))}", flush=True)
    for measure in ("mastered_area", "last_three"):
        for half, seeds in itertools.product((False, True), SIZES):
            shares = simulated(released(runs, measure), seeds, given.experiments, half=half)
            title = "half" if half else "all"
            print(f"`{given.release}`,`{measure}`,{title},{seeds},{','.join(shares)}", flush=True)


if __name__ == "__main__":
    main()
