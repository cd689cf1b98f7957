"""Agreement of the order of teachers in results with that in the paper's tables: Kendall's tau."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.claims.sources import PaperSource, RootSource, Sample
from analysis.data.frames import Frames
from analysis.data.reference import BASELINE
from analysis.statistics import stratum_weights
from analysis.statistics.samples import TAIL, Description
from tma_ray.benchmark import MATRICES
from tma_ray.benchmark.claims import Reading
from tma_ray.tasks import KnowledgeLevel

FEWEST = 3
"""Teachers that a ranking needs."""

DRAWS = 4_000
"""Draws of the bootstrap."""

SEED = 0
"""Of the draws: the same results always have the same interval."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Agreement:
    """Kendall's tau-b between two rankings of teachers by mean.

    Attributes:
        environment: name of the environment; empty for the mean over all challenges.
        challenge: name of the challenge; empty for the same.
        levels: expert knowledge, several where their runs are the same; none for the mean.
        teachers: names in both rankings; empty for the mean over all challenges.
        tau: 1 for the same order, -1 for the reverse; NaN if all means of a side are equal.
        low: lower end of its 95 % interval, of `tau_interval`; NaN if a teacher has a single run.
        high: upper end of it.
    """

    environment: str
    challenge: str
    levels: tuple[KnowledgeLevel, ...]
    teachers: tuple[str, ...]
    tau: float
    low: float
    high: float


def agreements(frames: Frames) -> list[Agreement]:
    """Return tau for each challenge and level in both, followed by its mean.

    Levels at which all teachers have the same runs are one row, held against the means of the paper's entries
    there.
    """
    rng = np.random.default_rng(SEED)
    found, draws, known = [], [], dict[frozenset[object], Floats]()
    for reading, levels, ranked in _rankings(RootSource(frames)):
        means = np.array(
            [
                (sample.description.mean, np.mean([each.mean for each in entries]))
                for sample, entries in ranked.values()
            ]
        ).T
        for sample, _ in ranked.values():
            if sample.runs not in known:
                known[sample.runs] = draws_of_runs(list(sample.strata.values()), rng)
        ours = np.stack([known[sample.runs] for sample, _ in ranked.values()], axis=-1)
        papers = np.stack([draws_of_entries(entries, rng) for _, entries in ranked.values()], axis=-1)
        tau, drawn = float(kendall(*means)), kendall(ours, papers)
        place = reading.environment, reading.challenge, levels, tuple(ranked)
        found.append(Agreement(*place, tau, *tau_interval(tau, drawn)))
        draws.append(drawn)
    if len(found) > 1:
        mean = float(np.mean([each.tau for each in found]))
        found.append(Agreement("", "", (), (), mean, *tau_interval(mean, np.mean(draws, axis=0))))
    return found


Ranked: TypeAlias = dict[str, tuple[Sample, list[Description]]]
"""Runs and the paper's entries of each teacher."""


def _rankings(root: RootSource) -> Iterator[tuple[Reading, tuple[KnowledgeLevel, ...], Ranked]]:
    """Yield a reading of each ranking, its levels, and the results of each teacher on both sides."""
    paper = PaperSource()
    for environment, challenge in dict.fromkeys((m.environment, m.challenge) for m in MATRICES):
        alike: dict[object, tuple[list[KnowledgeLevel], Ranked]] = {}
        for level in KnowledgeLevel:
            reading = Reading(BASELINE, challenge, level, environment)
            ranked: Ranked = {}
            for teacher in sorted(set(root.teachers(reading)) & set(paper.teachers(reading))):
                sides = (source.sample(replace(reading, teacher=teacher)) for source in (root, paper))
                mine, theirs = sides
                if mine is not None and theirs is not None:
                    ranked[teacher] = mine, [theirs.description]
            if len(ranked) < FEWEST:
                continue
            same = tuple((teacher, mine.runs) for teacher, (mine, _) in ranked.items())
            levels, before = alike.setdefault(same, ([], ranked))
            levels.append(level)
            if before is not ranked:
                for teacher, (_, entries) in ranked.items():
                    before[teacher][1].extend(entries)
        for levels, ranked in alike.values():
            yield Reading(BASELINE, challenge, levels[0], environment), tuple(levels), ranked


def draws_of_runs(strata: Sequence[pd.Series], rng: np.random.Generator) -> Floats:
    """Return the means of bootstrap samples of runs (draws,), strata of equal weight; NaN of a single run.

    Runs are drawn within their stratum; deviations from its mean are widened by the root of n / (n - 1), so
    that means of few runs scatter as much as they should.
    """
    found = np.zeros(DRAWS)
    for weight, stratum in zip(stratum_weights([0] * len(strata)), strata, strict=True):
        values, n = stratum.to_numpy(float), len(stratum)
        if n < 2:
            return np.full(DRAWS, np.nan)
        means = values[rng.integers(n, size=(DRAWS, n))].mean(axis=1)
        found += weight * (values.mean() + math.sqrt(n / (n - 1)) * (means - values.mean()))
    return found


def draws_of_entries(entries: Sequence[Description], rng: np.random.Generator) -> Floats:
    """Return draws of the mean of the paper's `entries` (draws,), whose runs are not known: normal ones."""
    mean = float(np.mean([each.mean for each in entries]))
    error = math.sqrt(sum(each.standard_error**2 for each in entries)) / len(entries)
    return mean + error * rng.standard_normal(DRAWS)


def kendall(first: Floats, second: Floats) -> Floats:
    """Return Kendall's tau-b of values (..., n) in two orders; NaN where all of one are equal."""
    one, other = np.triu_indices(first.shape[-1], 1)
    signs = [np.sign(each[..., one] - each[..., other]) for each in (first, second)]
    ordered = [np.abs(each).sum(axis=-1) for each in signs]
    with np.errstate(invalid="ignore"):
        return np.asarray((signs[0] * signs[1]).sum(axis=-1) / np.sqrt(ordered[0] * ordered[1]))


def tau_interval(tau: float, draws: Floats) -> tuple[float, float]:
    """Return the 95 % interval of the tau that as many other runs of the same teachers would have.

    Percentiles of a bootstrap over runs, moved to `tau`: draws around means that are noisy already move tau
    towards 0 once more than the runs themselves did. That first move remains: the order of the true means may
    agree better than runs show.

    Args:
        tau: tau of the results.
        draws: tau of each bootstrap draw (n,).
    """
    known = draws[np.isfinite(draws)]  # all means of a side may be equal in a draw
    if not known.size:
        return math.nan, math.nan
    moved = tau + known - known.mean()
    low, high = np.quantile(moved, [1 - TAIL, TAIL])
    return max(float(low), -1.0), min(float(high), 1.0)
