"""Smallest differences that a planned experiment can detect, from the spread of earlier results."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from functools import cache
from statistics import median
from typing import Any

import pandas as pd

from analysis.baselines.catalogue import find_baseline
from analysis.measures.pooling import pooled
from analysis.measures.student_pools import runs_after
from analysis.measures.tested import MEASURE
from analysis.statistics import Description
from analysis.statistics.power import detectable_difference
from tma_ray.benchmark import paper_results

COLUMNS = ["environment", "challenge", "seeds", "steadiest", "typical", "most_varied", "spread_of"]

PAPER, LITE = "paper", "lite-1"
"""Results that deviations are taken of: those of the paper's budget, and of a tenth of it."""

LITE_BUDGET = 6_000_000
"""Steps up to which a budget is nearer, as a ratio, to the 2 million of `LITE` than to the paper's 20."""


def detectable_differences(cell_rows: Sequence[Mapping[str, Any]], steps: int) -> pd.DataFrame:
    """Returns how far apart two teachers must be for a plan's seeds to tell, challenge by challenge.

    Args:
        cell_rows: rows of a plan's table of cells: environment, challenge, teacher, expert_knowledge.
        steps: budget of its runs.

    Returns:
        environment, challenge, seeds (of the teacher and level with the fewest, over all bodies and
        students), and the smallest difference of mastered tasks, in points, that Welch's test at 0.05 finds
        in 80 of 100 repetitions between two teachers of the smallest, the median and the largest standard
        deviation among the results named in spread_of: those of `LITE` up to `LITE_BUDGET` steps, where it
        has the challenge, else the paper's tables; NaN for a challenge that neither has, or a single seed.
    """
    rows = pd.DataFrame(list(cell_rows), columns=["environment", "challenge", "teacher", "expert_knowledge"])
    found = []
    for (environment, challenge), mine in rows.groupby(["environment", "challenge"], sort=False):
        seeds = int(mine.groupby(["teacher", "expert_knowledge"]).size().min())
        lite = _lite_deviations() if steps <= LITE_BUDGET else {}
        spread, name = lite.get((environment, challenge), []), LITE
        if not spread:
            spread, name = _deviations(environment, challenge, set(mine["expert_knowledge"])), PAPER
        marks = (min(spread), median(spread), max(spread)) if spread else (float("nan"),) * 3
        found.append([environment, challenge, seeds, *(_difference(seeds, std) for std in marks), name])
    return pd.DataFrame(found, columns=COLUMNS)


@cache
def _lite_deviations() -> dict[Hashable, list[float]]:
    """Returns by environment and challenge the standard deviations of `LITE`, of teachers with most seeds."""
    table = pooled(runs_after(find_baseline(LITE).frames(), training=False), [MEASURE])
    place = ["environment", "challenge"]
    whole = table.groupby(place)["n"].transform("max") == table["n"]
    groups = table[whole & (table[f"{MEASURE}_std"] > 0)].groupby(place)[f"{MEASURE}_std"]
    return {key: stds.tolist() for key, stds in groups}


def _deviations(environment: object, challenge: object, levels: set[str]) -> list[float]:
    """Returns the standard deviations in the paper's tables, over all bodies and students."""
    results = [r for r in paper_results() if (r.environment, r.challenge) == (environment, challenge)]
    whole = max((result.seeds for result in results), default=0)
    return [r.std for r in results if r.seeds == whole and r.expert_knowledge in levels and not r.doubt]


def _difference(seeds: int, std: float) -> float:
    sample = Description(n=seeds, mean=float("nan"), std=std)
    return detectable_difference(sample, sample)
