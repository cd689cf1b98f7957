"""Rank agreement of results with the paper's tables, measured by Kendall's tau."""

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
"""Smallest number of teachers in a ranking."""

BOOTSTRAP_DRAWS = 4_000

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Agreement:
    """Kendall's tau-b between two rankings of teachers by mean.

    Attributes:
        environment: environment; empty for the mean over all challenges.
        challenge: challenge; empty for the mean.
        levels: expert knowledge, several levels if their runs are the same; none for the mean.
        teachers: teachers in both rankings; none for the mean.
        tau: 1 for the same order, -1 for the reverse; NaN if all means in a ranking are equal.
        low: lower end of the 95 % interval of `tau_interval`; NaN if a teacher has a single run.
        high: upper end of the interval.
    """

    environment: str
    challenge: str
    levels: tuple[KnowledgeLevel, ...]
    teachers: tuple[str, ...]
    tau: float
    low: float
    high: float


def agreements(frames: Frames) -> list[Agreement]:
    """Return the rank agreement with the paper on each challenge and level, followed by their mean.

    Levels at which all teachers have the same runs are one row, compared with the means of the paper's
    entries.
    """
    rng = np.random.default_rng(0)
    rows, draws, draws_by_runs = [], [], dict[frozenset[object], Floats]()
    for reading, levels, ranked in _rankings(RootSource(frames)):
        means = np.array(
            [
                (sample.description.mean, np.mean([entry.mean for entry in entries]))
                for sample, entries in ranked.values()
            ]
        ).T
        for sample, _ in ranked.values():
            if sample.runs not in draws_by_runs:
                draws_by_runs[sample.runs] = draws_of_runs(list(sample.strata.values()), rng)
        ours = np.stack([draws_by_runs[sample.runs] for sample, _ in ranked.values()], axis=-1)
        papers = np.stack([draws_of_entries(entries, rng) for _, entries in ranked.values()], axis=-1)
        tau, drawn = float(kendall(*means)), kendall(ours, papers)
        ranking = reading.environment, reading.challenge, levels, tuple(ranked)
        rows.append(Agreement(*ranking, tau, *tau_interval(tau, drawn)))
        draws.append(drawn)
    if len(rows) > 1:
        mean = float(np.mean([row.tau for row in rows]))
        rows.append(Agreement("", "", (), (), mean, *tau_interval(mean, np.mean(draws, axis=0))))
    return rows


Ranked: TypeAlias = dict[str, tuple[Sample, list[Description]]]
"""Runs and the paper's entries, by teacher."""


def _rankings(root: RootSource) -> Iterator[tuple[Reading, tuple[KnowledgeLevel, ...], Ranked]]:
    """Yield a challenge, the levels that share the same runs, and the teachers' results in both rankings."""
    paper = PaperSource()
    for environment, challenge in dict.fromkeys((m.environment, m.challenge) for m in MATRICES):
        by_runs: dict[object, tuple[list[KnowledgeLevel], Ranked]] = {}
        for level in KnowledgeLevel:
            reading = Reading(BASELINE, challenge, level, environment)
            ranked: Ranked = {}
            for teacher in sorted(set(root.teachers(reading)) & set(paper.teachers(reading))):
                runs, entry = (source.sample(replace(reading, teacher=teacher)) for source in (root, paper))
                if runs is not None and entry is not None:
                    ranked[teacher] = runs, [entry.description]
            if len(ranked) < FEWEST:
                continue
            key = tuple((teacher, runs.runs) for teacher, (runs, _) in ranked.items())
            levels, first = by_runs.setdefault(key, ([], ranked))
            levels.append(level)
            if first is not ranked:
                for teacher, (_, entries) in ranked.items():
                    first[teacher][1].extend(entries)
        for levels, ranked in by_runs.values():
            yield Reading(BASELINE, challenge, levels[0], environment), tuple(levels), ranked


def draws_of_runs(strata: Sequence[pd.Series], rng: np.random.Generator) -> Floats:
    """Return bootstrap draws (n,) of the equally weighted mean over strata, NaN if a stratum has one run.

    Runs are drawn within strata, and deviations scaled by the root of n / (n - 1), which corrects the
    bootstrap's variance for few runs.
    """
    draws = np.zeros(BOOTSTRAP_DRAWS)
    for weight, stratum in zip(stratum_weights([0] * len(strata)), strata, strict=True):
        values, n = stratum.to_numpy(float), len(stratum)
        if n < 2:
            return np.full(BOOTSTRAP_DRAWS, np.nan)
        means = values[rng.integers(n, size=(BOOTSTRAP_DRAWS, n))].mean(axis=1)
        draws += weight * (values.mean() + math.sqrt(n / (n - 1)) * (means - values.mean()))
    return draws


def draws_of_entries(entries: Sequence[Description], rng: np.random.Generator) -> Floats:
    """Draw means (n,) of the paper's entries from a normal distribution."""
    mean = float(np.mean([entry.mean for entry in entries]))
    error = math.sqrt(sum(entry.standard_error**2 for entry in entries)) / len(entries)
    return mean + error * rng.standard_normal(BOOTSTRAP_DRAWS)


def kendall(first: Floats, second: Floats) -> Floats:
    """Return Kendall's tau-b of two arrays (..., n), NaN where all values in one of them are equal."""
    rows, columns = np.triu_indices(first.shape[-1], 1)
    signs = [np.sign(values[..., rows] - values[..., columns]) for values in (first, second)]
    ordered = [np.abs(sign).sum(axis=-1) for sign in signs]
    with np.errstate(invalid="ignore"):
        return np.asarray((signs[0] * signs[1]).sum(axis=-1) / np.sqrt(ordered[0] * ordered[1]))


def tau_interval(tau: float, draws: Floats) -> tuple[float, float]:
    """Return the 95 % prediction interval of tau for as many new runs of the same teachers.

    Bootstrap percentiles are shifted to `tau`, since noise of the draws biases tau towards 0 once more. The
    bias by noise of the runs remains: the order of the true means may agree better.

    Args:
        tau: tau of the results.
        draws: tau of each bootstrap draw (n,).
    """
    finite = draws[np.isfinite(draws)]  # tau is NaN for draws in which all means are equal
    if not finite.size:
        return math.nan, math.nan
    low, high = np.quantile(tau + finite - finite.mean(), [1 - TAIL, TAIL])
    return max(float(low), -1.0), min(float(high), 1.0)
