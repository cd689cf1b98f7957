"""The ranking of teachers on each challenge, each beside Random."""

from __future__ import annotations

import pandas as pd

from analysis.comparisons.findings import FEW_SEEDS
from analysis.comparisons.pairwise import pairwise
from analysis.data.frames import Frames
from analysis.data.reference import is_baseline
from analysis.measures.pooling import COMPARED, POOLED, pooled
from analysis.measures.student_pools import runs_after
from analysis.names import label
from analysis.statistics import SIGNIFICANCE

MEASURE = "mastered_percent"

TEACHER = ["environment", "expert_knowledge", "teacher"]
"""Columns that tell the results of one sentence: a teacher's at one level, over all challenges."""


def ranking(frames: Frames, share: float = 1.0) -> pd.DataFrame:
    """Returns one row for each result: a teacher at a level on a challenge, pooled as the paper pools.

    Args:
        frames: what was run.
        share: of the budget, after which runs are read.

    Returns:
        `pooling.POOLED`, runs, n, missing, mastered_percent_mean and _std, rank (1 for the highest mean of
        a comparison), and of Welch's test against Random: difference, low, high, p, reason, and holm: p
        adjusted for all teachers of the comparison. Best first.
    """
    return ranked(runs_after(frames, share))


def ranked(runs: pd.DataFrame) -> pd.DataFrame:
    """Returns the rows of `ranking`, from runs of `student_pools.runs_after`."""
    table = pooled(runs, [MEASURE])
    tests = pairwise(runs, MEASURE, "random").rename(columns={"first": "teacher"})
    columns = ["difference", "low", "high", "p", "holm", "reason"]
    table = table.merge(tests[[*POOLED, *columns]], on=POOLED, how="left")
    table["reason"] = table["reason"].fillna("")
    means = table.groupby(COMPARED, dropna=False)[f"{MEASURE}_mean"]
    table["rank"] = means.rank(ascending=False, method="min")
    return table.sort_values([*COMPARED, "rank", "teacher"], ignore_index=True)


def sentences(table: pd.DataFrame) -> list[str]:
    """Returns what a `ranking` says of every teacher but Random, in plain words.

    Differences count as found where p is under 0.05 after Holm's correction for all teachers of a challenge.
    """
    said = []
    for key, rows in table.groupby(TEACHER, sort=True):
        environment, level, teacher = map(str, key)
        tested = rows[rows["p"].notna()]
        if is_baseline(teacher) or tested.empty:
            continue
        better = int(((tested["holm"] < SIGNIFICANCE) & (tested["difference"] > 0)).sum())
        worse = int(((tested["holm"] < SIGNIFICANCE) & (tested["difference"] < 0)).sum())
        rest = len(tested) - better - worse
        parts = [f"better than Random on {better} of {len(tested)}"]
        parts += [f"worse on {worse}"] if worse else []
        parts += [f"not distinguishable on {rest}"] if rest else []
        few = "; few seeds" if tested["n"].min() < FEW_SEEDS else ""
        where = f"{environment}, expert knowledge {level}"
        said.append(f"{label(teacher)} ({where}): {', '.join(parts)} (p < {SIGNIFICANCE} after Holm{few}).")
    return said
