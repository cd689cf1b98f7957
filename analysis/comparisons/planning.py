"""Smallest differences that a planned experiment can detect, from the spread that the paper found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

import pandas as pd

from analysis.statistics import Description
from analysis.statistics.power import detectable_difference
from tma_ray.benchmark import paper_results

COLUMNS = ["environment", "challenge", "seeds", "steadiest", "typical", "most_varied"]


def detectable_differences(cell_rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Returns how far apart two teachers must be for a plan's seeds to tell, challenge by challenge.

    Args:
        cell_rows: rows of a plan's table of cells: environment, challenge, teacher, expert_knowledge.

    Returns:
        environment, challenge, seeds (of the teacher and level with the fewest, over all bodies and
        students), and the smallest difference of mastered tasks, in points, that Welch's test at 0.05 finds
        in 80 of 100 repetitions between two teachers of the smallest, the median and the largest standard
        deviation in the paper's tables; NaN for a challenge that they do not have, or a single seed.
    """
    rows = pd.DataFrame(list(cell_rows), columns=["environment", "challenge", "teacher", "expert_knowledge"])
    found = []
    for (environment, challenge), mine in rows.groupby(["environment", "challenge"], sort=False):
        seeds = int(mine.groupby(["teacher", "expert_knowledge"]).size().min())
        spread = _deviations(environment, challenge, set(mine["expert_knowledge"]))
        marks = (min(spread), median(spread), max(spread)) if spread else (float("nan"),) * 3
        found.append([environment, challenge, seeds, *(_difference(seeds, std) for std in marks)])
    return pd.DataFrame(found, columns=COLUMNS)


def _deviations(environment: object, challenge: object, levels: set[str]) -> list[float]:
    """Returns the standard deviations in the paper's tables, over all bodies and students."""
    results = [r for r in paper_results() if (r.environment, r.challenge) == (environment, challenge)]
    whole = max((result.seeds for result in results), default=0)
    return [r.std for r in results if r.seeds == whole and r.expert_knowledge in levels and not r.doubt]


def _difference(seeds: int, std: float) -> float:
    sample = Description(n=seeds, mean=float("nan"), std=std)
    return detectable_difference(sample, sample)
