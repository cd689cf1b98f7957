"""The ranking of teachers on each challenge, each beside Random."""

from __future__ import annotations

import pandas as pd

from analysis.comparisons.few_seeds import in_brief
from analysis.comparisons.pairwise import pairwise
from analysis.data.frames import Frames
from analysis.data.reference import is_baseline
from analysis.measures.conditions import CONDITIONS, condition_words, varying
from analysis.measures.pooling import COMPARED, POOLED, pooled
from analysis.measures.student_pools import runs_after
from analysis.measures.tested import MEASURE
from analysis.names import challenge_title, label
from analysis.statistics import SIGNIFICANCE

TEACHER = ["environment", "expert_knowledge", "teacher", *CONDITIONS]
"""Columns that tell the results of one sentence: a teacher's at one level, of one kind."""


def ranking(frames: Frames, share: float = 1.0, measure: str = MEASURE) -> pd.DataFrame:
    """Returns one row for each result: a teacher at a level on a challenge, pooled as the paper pools.

    Args:
        frames: what was run.
        share: of the budget, after which runs are read.
        measure: of `tested.MEASURES`.

    Returns:
        `pooling.POOLED`, runs, n, missing, mean and standard deviation (as mastered_percent_mean and _std),
        worst (of a single run), rank (1 for the highest mean of a comparison), and of Welch's test against
        Random: reference_n (its runs), difference, low, high, p, reason, and holm: p adjusted for all
        teachers of the comparison. Best first.
    """
    return ranked(runs_after(frames, share, training=False), measure)


def ranked(runs: pd.DataFrame, measure: str = MEASURE) -> pd.DataFrame:
    """Returns the rows of `ranking`, from runs of `student_pools.runs_after`."""
    table = pooled(runs, [measure])
    tests = pairwise(runs, measure, "random", detectable=False).rename(columns={"first": "teacher"})
    columns = ["reference_n", "difference", "low", "high", "p", "holm", "reason"]
    table = table.merge(tests[[*POOLED, *columns]], on=POOLED, how="left")
    table["reason"] = table["reason"].fillna("")
    worst = runs.groupby(POOLED, dropna=False, sort=True)[measure].min()  # in the order of `table`
    table["worst"] = worst.to_numpy()
    means = table.groupby(COMPARED, dropna=False)[f"{measure}_mean"]
    table["rank"] = means.rank(ascending=False, method="min")
    return table.sort_values([*COMPARED, "rank", "teacher"], ignore_index=True)


def sentences(table: pd.DataFrame) -> list[str]:
    """Returns what a `ranking` says of every teacher but Random, in plain words.

    Differences count as found where p is under 0.05 after Holm's correction for all teachers of a challenge.
    """
    said, told = [], varying(table[table["p"].notna()])
    for key, rows in table.groupby(TEACHER, sort=True, dropna=False):
        environment, level, teacher = map(str, key[:3])
        tested = rows[rows["p"].notna()]
        if is_baseline(teacher) or tested.empty:
            continue
        better = int(((tested["holm"] < SIGNIFICANCE) & (tested["difference"] > 0)).sum())
        worse = int(((tested["holm"] < SIGNIFICANCE) & (tested["difference"] < 0)).sum())
        rest = len(tested) - better - worse
        parts = [f"better than Random on {better} of {len(tested)}"]
        parts += [f"worse on {worse}"] if worse else []
        parts += [f"not distinguishable on {rest}"] if rest else []
        few = in_brief(tested[["n", "reference_n"]].min().min())
        where = ", ".join([environment, f"expert knowledge {level}", *condition_words(rows.iloc[0], told)])
        said.append(f"{label(teacher)} ({where}): {', '.join(parts)} (p < {SIGNIFICANCE} after Holm{few}).")
    return said


def places(table: pd.DataFrame) -> list[str]:
    """Returns the challenge of each row, with what sets it apart from others of its name in the table.

    Args:
        table: with the columns `pooling.COMPARED`.
    """
    here = ["environment", "challenge", "expert_knowledge"]
    several = ["pool", "test_sets", *(name for name in CONDITIONS if name != "variant")]
    told = {name: table.groupby(here)[name].transform("nunique", dropna=False) > 1 for name in several}
    found = []
    for position, (_, row) in enumerate(table.iterrows()):
        environment, challenge = row["environment"], row["challenge"]
        title = challenge_title(environment, challenge, f"{environment} {challenge}")
        apart = [name for name in several if told[name].iloc[position]]
        named = [str(row[name]) for name in ("pool", "test_sets") if name in apart and pd.notna(row[name])]
        words = condition_words(row, [name for name in apart if name in CONDITIONS])
        found.append(", ".join([title, *named, *words]))
    return found
