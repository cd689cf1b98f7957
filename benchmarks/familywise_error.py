"""Tests over challenges on a release: pairs they decide, and how often they find what is not there.

    python benchmarks/familywise_error.py

Prints the rows of ``measured/pairs_decided.csv`` and ``measured/false_findings.csv``, and coverages.
Simulated runs are those of the release with the means of their cells taken away, drawn with replacement in
each cell (a teacher, challenge and body), so that every cell keeps its own spread and skew.
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
from analysis.measures.tested import MEASURES, compared_over_strata, scale_of
from analysis.statistics import SIGNIFICANCE, Scale, holm
from analysis.statistics.tests import LEAST

SIZES = (3, 5, 10)
PERMUTATIONS = 299

Floats = NDArray[np.float64]


class Release(NamedTuple):
    """Runs of teachers that have all seeds on all challenges.

    Attributes:
        values: percentages of a measure (cells, teachers, seeds); cells are challenges and bodies.
        weights: of the cells, equal for challenges, which add up to 1 (cells,).
        random: place of Random among the teachers.
    """

    values: Floats
    weights: Floats
    random: int


class Families(NamedTuple):
    """Adjusted p-values of all pairs of teachers (pairs,), and of Random's pairs."""

    pairs: Floats
    random: Floats


def released(runs: pd.DataFrame, measure: str) -> Release:
    """Return what the core of a release has of `measure`, of `runs_after`."""
    table = runs.pivot_table(index=["challenge", "embodiment"], columns=["teacher", "seed"], values=measure)
    teachers = list(table.columns.unique("teacher"))
    challenges = table.index.get_level_values("challenge").to_series().reset_index(drop=True)
    weights = 1 / challenges.groupby(challenges).transform("size").to_numpy(float)
    values = table.to_numpy(float).reshape(len(table), len(teachers), -1)
    return Release(values, weights / weights.sum(), teachers.index("random"))


def on_scale(values: Floats, scale: Scale) -> Floats:
    """Return percentages on a scale, in their shape."""
    return scale.of(pd.Series(values.ravel())).to_numpy(float).reshape(values.shape)


def welch(values: Floats, weights: Floats, least: float = 0.0) -> tuple[Floats, Floats]:
    """Return t and p of Welch and Satterthwaite's test of each pair (..., pairs) over cells.

    Args:
        values: results of runs (..., cells, teachers, seeds).
        weights: weights of the cells (cells,).
        least: share of the mean variance of a cell's teachers under which none counts.
    """
    first, second = np.triu_indices(values.shape[-2], 1)
    n = values.shape[-1]
    means = np.einsum("c,...ct->...t", weights, values.mean(-1))
    parts = weights[:, None] ** 2 * values.var(-1, ddof=1) / n
    own, squares = parts.sum(-2), (parts**2).sum(-2) / (n - 1)
    variance = own[..., first] + own[..., second]
    errors = np.maximum(parts, least * parts.mean(-1, keepdims=True)).sum(-2)
    t = np.abs(means[..., first] - means[..., second]) / np.sqrt(errors[..., first] + errors[..., second])
    return t, 2 * special.stdtr(variance**2 / (squares[..., first] + squares[..., second]), -t)


def by_holm(values: Floats, release: Release, _: np.random.Generator, least: float = 0.0) -> Families:
    """Return Welch and Satterthwaite's p with Holm's correction."""
    p = welch(values, release.weights, least)[1]
    return Families(holm(p), holm(p[_of_random(release)]))


def by_permutation(
    values: Floats, release: Release, rng: np.random.Generator, permutations: int = PERMUTATIONS
) -> Families:
    """Return the step-down max-t p of Westfall and Young (1993): runs change teachers within their cell."""
    cells, teachers, n = values.shape
    order = np.argsort(rng.random((permutations, cells, teachers * n)), axis=-1)
    shuffled = np.take_along_axis(values.reshape(1, cells, -1), order, -1).reshape(-1, cells, teachers, n)
    found, drawn = welch(values, release.weights)[0], welch(shuffled, release.weights)[0]
    mine = _of_random(release)
    return Families(_step_down(found, drawn), _step_down(found[mine], drawn[:, mine]))


def _step_down(found: Floats, drawn: Floats) -> Floats:
    order = np.argsort(found)
    largest = np.maximum.accumulate(drawn[:, order], axis=1)
    shares = (1 + (largest >= found[order]).sum(axis=0)) / (1 + len(drawn))
    adjusted = np.empty(len(found))
    adjusted[order] = np.maximum.accumulate(shares[::-1])[::-1]
    return adjusted


def _of_random(release: Release) -> NDArray[np.bool_]:
    first, second = np.triu_indices(release.values.shape[1], 1)
    return np.asarray((first == release.random) | (second == release.random))


METHODS: dict[str, Callable[[Floats, Release, np.random.Generator], Families]] = {
    "Welch": by_holm,
    "least variance": partial(by_holm, least=LEAST),
    "max-t permutation": by_permutation,
}


def simulated(release: Release, scale: Scale, seeds: int, experiments: int, *, half: bool) -> list[str]:
    """Return for each method and family the share of experiments with a false finding, and the true ones.

    Args:
        release: runs whose residuals are drawn.
        scale: scale on which teachers are equal, and tested.
        seeds: number of runs in each cell.
        experiments: number of simulated releases.
        half: True if every second teacher keeps its means; else all are equal.
    """
    rng = np.random.default_rng([seeds, half])
    values = on_scale(release.values, scale)
    n = values.shape[-1]
    means = values.mean(-1, keepdims=True)
    residuals = (values - means) * np.sqrt(n / (n - 1))
    others = np.arange(means.shape[1]) % 2 == (release.random + 1) % 2
    shift = np.where(others[:, None] & half, means - means[:, ~others].mean(axis=1, keepdims=True), 0.0)
    first, second = np.triu_indices(means.shape[1], 1)
    null = ~(others[first] | others[second]) | (not half)
    nulls = null, null[_of_random(release)]
    wrong, right = np.zeros((len(METHODS), 2)), np.zeros((len(METHODS), 2))
    for _ in range(experiments):
        drawn = rng.integers(0, n, (*means.shape[:2], seeds))
        runs = shift + np.take_along_axis(residuals, drawn, -1)
        for row, method in enumerate(METHODS.values()):
            for column, (p, equal) in enumerate(zip(method(runs, release, rng), nulls, strict=True)):
                wrong[row, column] += (p[equal] < SIGNIFICANCE).any()
                right[row, column] += (p[~equal] < SIGNIFICANCE).sum()
    shares = zip((100 * wrong / experiments).T.ravel(), (right / experiments).T.ravel(), strict=True)
    return [f"{share:.1f}" + (f" ({true:.1f})" if half else "") for share, true in shares]


def coverage(release: Release, scale: Scale, seeds: int, experiments: int) -> float:
    """Return how often the interval that is shown of a difference holds the true one, in %."""
    rng, held = np.random.default_rng(seeds), []
    teachers = release.values.shape[1]
    for _ in range(experiments):
        drawn = rng.integers(0, release.values.shape[-1], (*release.values.shape[:2], seeds))
        runs = np.take_along_axis(release.values, drawn, -1)
        for pair in itertools.combinations(range(teachers), 2):
            samples = [
                tuple(pd.Series(cell[k], index=[f"{k}-{i}" for i in range(seeds)]) for k in pair)
                for cell in runs
            ]
            first, second = (release.weights @ release.values[:, k].mean(-1) for k in pair)
            test = compared_over_strata([(a, b) for a, b in samples], list(release.weights), {}, scale)
            held.append(test.low <= first - second <= test.high)
    return float(100 * np.mean(held))


def main() -> None:
    """Print the pairs that each test decides, its false findings, and the coverage of intervals."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("--experiments", type=int, default=1_000, help="simulated for each row (%(default)s)")
    parser.add_argument("--release", default="lite-2", help="release whose runs are taken (%(default)s)")
    given = parser.parse_args()
    baseline = find_baseline(given.release)
    frames = baseline.frames()
    core = frames.cells.loc[frames.cells["campaign"].isin(baseline.manifest.core), "run_id"]
    runs = runs_after(frames, training=False)
    runs = runs[runs["run_id"].isin(core)]
    for measure, scale in itertools.product(MEASURES, Scale):
        release, rng = released(runs, measure), np.random.default_rng(0)
        values = on_scale(release.values, scale)
        finer = METHODS | {"max-t permutation": partial(by_permutation, permutations=9_999)}
        found = [method(values, release, rng) for method in finer.values()]
        counts = ((p < SIGNIFICANCE).sum() for p in (*(f.pairs for f in found), *(f.random for f in found)))
        print(f"`{given.release}`,`{measure}`,{scale},{','.join(map(str, counts))}", flush=True)
    for measure in ("mastered_area", "last_three"):
        release, scale = released(runs, measure), scale_of(measure)
        for half, seeds in itertools.product((False, True), SIZES):
            shares = simulated(release, scale, seeds, given.experiments, half=half)
            title = "half" if half else "all"
            print(f"`{given.release}`,`{measure}`,{title},{seeds},{','.join(shares)}", flush=True)
    for seeds in SIZES:
        held = coverage(released(runs, "mastered_area"), Scale.ARCSINE, seeds, 1 + given.experiments // 40)
        print(f"`{given.release}`,{seeds},{held:.1f}", flush=True)


if __name__ == "__main__":
    main()
