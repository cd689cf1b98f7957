"""Agreement of a root's ranking of teachers with the paper's, challenge by challenge: Kendall's tau."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.claims.sources import PaperSource, RootSource
from analysis.data.frames import Frames
from analysis.statistics import CONFIDENCE, Description
from tma_ray.benchmark import MATRICES
from tma_ray.benchmark.statements import Reading
from tma_ray.tasks import KnowledgeLevel

FEWEST = 3
"""Teachers that a ranking needs."""

DRAWS = 4_000
"""Of the means of both sides, for an interval."""


@dataclass(frozen=True)
class Agreement:
    """Kendall's tau-b between two rankings of teachers by mean.

    Attributes:
        environment: name of the environment; empty for the mean over all challenges.
        challenge: name of the challenge; empty likewise.
        level: expert knowledge; None for several.
        teachers: who is in both rankings; empty for the mean over all challenges.
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


def agreements(frames: Frames, seed: int = 0) -> list[Agreement]:
    """Returns tau for each challenge and level that both have, and last its mean over all of them.

    The interval is that of tau when the means of both sides are drawn from their Student's t distributions:
    of the mean, with the standard error of its runs. It says how far the order depends on the seeds. Noise
    lowers tau, so the interval is widened where it would leave out tau itself.

    Args:
        frames: of a root or release.
        seed: of the draws.
    """
    root, paper, rng = RootSource(frames), PaperSource(), np.random.default_rng(seed)
    found, draws = [], []
    for reading in _readings():
        names = sorted(set(root.teachers(reading)) & set(paper.teachers(reading)))
        sides = [[source.sample(_of(name, reading)) for name in names] for source in (root, paper)]
        pairs = [
            (name, mine.description, theirs.description)
            for name, mine, theirs in zip(names, *sides, strict=True)
            if mine is not None and theirs is not None
        ]
        if len(pairs) < FEWEST:
            continue
        ours, papers = [mine for _, mine, _ in pairs], [theirs for *_, theirs in pairs]
        drawn = taus(_drawn(ours, rng), _drawn(papers, rng))
        tau = float(taus(_means(ours), _means(papers))[0])
        teachers = tuple(name for name, *_ in pairs)
        place = (reading.environment, reading.challenge, reading.level)
        found.append(Agreement(*place, teachers, tau, *_interval(drawn, tau)))
        draws.append(drawn)
    if len(found) > 1:
        together = np.mean(draws, axis=0)
        mean = float(np.mean([each.tau for each in found]))
        found.append(Agreement("", "", None, (), mean, *_interval(together, mean)))
    return found


def taus(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns Kendall's tau-b of each row of two arrays (n, teachers); NaN where a row is constant or NaN."""
    pairs = np.triu_indices(first.shape[1], 1)
    signs = [np.sign(side[:, pairs[0]] - side[:, pairs[1]]) for side in (first, second)]
    untied = [np.abs(sign).sum(axis=1) for sign in signs]
    with np.errstate(invalid="ignore", divide="ignore"):
        found: NDArray[np.float64] = (signs[0] * signs[1]).sum(axis=1) / np.sqrt(untied[0] * untied[1])
    return found


def _readings() -> list[Reading]:
    """Returns the places that the paper has results of, teachers left open."""
    places = dict.fromkeys((m.environment, m.challenge, level) for m in MATRICES for level in m.levels)
    return [Reading("random", challenge, level, environment) for environment, challenge, level in places]


def _of(teacher: str, reading: Reading) -> Reading:
    return Reading(teacher, reading.challenge, reading.level, reading.environment)


def _means(samples: Sequence[Description]) -> NDArray[np.float64]:
    return np.array([[sample.mean for sample in samples]])


def _drawn(samples: Sequence[Description], rng: np.random.Generator) -> NDArray[np.float64]:
    """Returns draws of the means (DRAWS, teachers); NaN for a teacher with a single run."""
    columns = [_draw(sample, rng) for sample in samples]
    return np.stack(columns, axis=1)


def _draw(sample: Description, rng: np.random.Generator) -> NDArray[np.float64]:
    return sample.mean + sample.standard_error * rng.standard_t(max(sample.n - 1, 1), DRAWS)


def _interval(drawn: NDArray[np.float64], tau: float) -> tuple[float, float]:
    if not np.isfinite(drawn).all():
        return float("nan"), float("nan")
    low, high = np.quantile(drawn, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return min(float(low), tau), max(float(high), tau)
