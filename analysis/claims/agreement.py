"""Agreement of a root's ranking of teachers with the paper's, challenge by challenge: Kendall's tau."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.claims.judging import PaperSource, RootSource
from analysis.data.frames import Frames
from analysis.data.reference import BASELINE
from analysis.statistics import SIGNIFICANCE, Description, holm, welch_from_statistics
from tma_ray.benchmark import MATRICES
from tma_ray.benchmark.claims import Reading
from tma_ray.tasks import KnowledgeLevel

FEWEST = 3
"""Teachers that a ranking needs."""


@dataclass(frozen=True)
class Agreement:
    """Kendall's tau-b between two rankings of teachers by mean.

    Attributes:
        environment: name of the environment; empty for the mean over all challenges.
        challenge: name of the challenge; empty for the same.
        level: expert knowledge; None for several.
        teachers: names in both rankings; empty for the mean over all challenges.
        tau: 1 for the same order, -1 for the reverse; NaN if all means of a side are equal.
        low: lower end of its 95 % interval; NaN if a teacher has a single run.
        high: upper end of it.
    """

    environment: str
    challenge: str
    level: KnowledgeLevel | None
    teachers: tuple[str, ...]
    tau: float
    low: float
    high: float


def agreements(frames: Frames) -> list[Agreement]:
    """Return tau for each challenge and level that both have, and last its mean over all of them.

    Tau is a mean over pairs of teachers, of 1 for a pair in the same order on both sides and -1 for one in
    the reverse. An order is known of pairs that Welch's tests tell apart on both sides, after Holm's
    correction for all pairs that tau is of; the interval holds all values that the others leave possible.
    So with probability 0.95 or more it holds the tau of the true means, wherever these are: noise moves tau
    towards 0, and draws around noisy means, such as a bootstrap's, move it there once more.
    """
    from scipy import stats  # it takes a second to import

    root, paper = RootSource(frames), PaperSource()
    found, everywhere = [], []
    places = dict.fromkeys((m.environment, m.challenge, level) for m in MATRICES for level in m.levels)
    for environment, challenge, level in places:
        reading = Reading(BASELINE, challenge, level, environment)
        names = sorted(set(root.teachers(reading)) & set(paper.teachers(reading)))
        sides = [
            [source.sample(replace(reading, teacher=name)) for name in names] for source in (root, paper)
        ]
        pairs = [
            (name, mine.description, theirs.description)
            for name, mine, theirs in zip(names, *sides, strict=True)
            if mine is not None and theirs is not None
        ]
        if len(pairs) < FEWEST:
            continue
        ours, papers = [mine for _, mine, _ in pairs], [theirs for *_, theirs in pairs]
        tau = float(stats.kendalltau(*([each.mean for each in side] for side in (ours, papers))).statistic)
        compared = pairs_in_both(ours, papers)
        teachers = tuple(name for name, *_ in pairs)
        found.append(Agreement(environment, challenge, level, teachers, tau, *tau_interval([compared])))
        everywhere.append(compared)
    if len(found) > 1:
        mean = float(np.mean([each.tau for each in found]))
        found.append(Agreement("", "", None, (), mean, *tau_interval(everywhere)))
    return found


def pairs_in_both(
    first: Sequence[Description], second: Sequence[Description]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return for each pair of teachers (n,) 1 or -1, same order or reverse, and the p-value of that.

    The order of a pair is known in both samples of the same teachers where it is in each: p is the larger.
    """
    tests = [
        [welch_from_statistics(*pair) for pair in itertools.combinations(side, 2)] for side in (first, second)
    ]
    signs = np.prod([[np.sign(test.difference) for test in side] for side in tests], axis=0)
    return signs, np.max([[test.p for test in side] for side in tests], axis=0)


def tau_interval(
    challenges: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]],
) -> tuple[float, float]:
    """Return the ends of the interval of tau, of its mean for several challenges, each of `pairs_in_both`."""
    if any(np.isnan(p).all() for _, p in challenges):
        return float("nan"), float("nan")
    known = np.split(
        holm(np.concatenate([p for _, p in challenges])) < SIGNIFICANCE,
        np.cumsum([len(p) for _, p in challenges])[:-1],
    )
    parts = zip(challenges, known, strict=True)
    low, high = np.mean(
        [[np.where(sure, signs, end).mean() for end in (-1, 1)] for (signs, _), sure in parts], axis=0
    )
    return float(low), float(high)
