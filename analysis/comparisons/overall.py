"""Results over all challenges at once: differences, means, improvements, profiles."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import Any

import pandas as pd

from analysis.comparisons.aggregates import (
    ACROSS,
    CHALLENGES,
    PLACES,
    improvements,
    profiles,
    stratified_differences,
    stratified_means,
)
from analysis.comparisons.few_seeds import in_brief
from analysis.comparisons.leaderboard import on_the_same
from analysis.data.reference import BASELINE
from analysis.formatting import ends, estimate, number, p_value
from analysis.looks import look
from analysis.measures.conditions import CONDITIONS, condition_words, varying
from analysis.measures.tested import MEASURE
from analysis.names import label, mark_of, marked_label
from analysis.statistics import SIGNIFICANCE

THRESHOLDS = (25, 50, 75)
"""Per cent of the test tasks, over which the share of runs is told in tables."""

BLOCK = [*ACROSS, "block", "challenges", "of"]
"""Columns that the rows of `overall` have in common that are read together."""

STEPS = tuple(range(0, 100, 2))
"""The same of the curves that are performance profiles."""


def headlines(
    runs: pd.DataFrame, measure: str = MEASURE, teachers: Collection[str] | None = None
) -> list[str]:
    """Returns the differences of teachers to Random over all challenges, a sentence for each verdict.

    Few seeds of one challenge decide little, all challenges together more. A teacher is better or worse where
    p is under 0.05 after Holm's correction for all teachers at that level.

    Args:
        runs: rows of `pooling.pool_runs`.
        measure: column of `runs`, in per cent.
        teachers: that are told of; all by default.
    """
    if runs.empty:
        return []
    table = stratified_differences(runs, measure, BASELINE)
    table = table[(table["reason"] == "") & (table["challenges"] > 1)]
    table = table if teachers is None else table[table["teacher"].isin(teachers)]
    table = table.sort_values([*ACROSS, "difference"], ascending=[*[True] * len(ACROSS), False])
    told = {"steps", *varying(table), *(["variant"] if (table["variant"] != "").any() else [])}
    found: dict[str, list[str]] = {}
    for _, row in table.iterrows():
        words = condition_words(row, [name for name in CONDITIONS if name in told])
        where = ", ".join([f"expert knowledge {row['expert_knowledge']}", *words])
        verdict = "not distinguishable from"
        if row["holm"] < SIGNIFICANCE:
            verdict = "better than" if row["difference"] > 0 else "worse than"
        said = f"Over {row['challenges']} challenges ({where}) {verdict} Random, in points"
        found.setdefault(said, []).append(_difference(row))
    return [f"{said}: {'; '.join(teachers)}." for said, teachers in found.items()]


def _difference(row: pd.Series) -> str:
    interval = f"{number(row['difference'])} {ends(row['low'], row['high'])}"
    few = in_brief(row["fewest"]).replace("; ", ", ")
    return f"{label(row['teacher'])} {interval}, {p_value(row['holm'])} after Holm{few}"


def overall(runs: pd.DataFrame, measure: str = MEASURE) -> pd.DataFrame:
    """Returns one row for each teacher at each level and budget, on the same challenges, the best first.

    Teachers are set side by side on the same challenges only: apart from those that have results on all,
    there is a block of rows for each smaller set of challenges that is all that some teacher has, of everyone
    who has these.

    Args:
        runs: rows of `pooling.pool_runs`.
        measure: column of `runs`, in per cent.

    Returns:
        `ACROSS`, block (number of the set of challenges), challenges (number of them), of (number that there
        are), teacher, n, and with their 95 % intervals mean, low_mean, high_mean: mean over challenges of
        equal weight; better, low_better, high_better: probability that a run is better than one of Random on
        the same challenge (Agarwal et al., 2021); worst: result of the worst run, the mean over challenges;
        over_25 and so on: share of runs over so many per cent.
    """
    blocks = [
        _block(part, measure).assign(block=block, challenges=_challenges(part), of=of)
        for _, group in runs[runs[measure].notna()].groupby(ACROSS, dropna=False, sort=True)
        for block, (part, of) in enumerate(on_the_same(group))
    ]
    table = pd.concat(blocks, ignore_index=True) if blocks else pd.DataFrame()
    return table.reindex(columns=list(dict.fromkeys([*BLOCK, "teacher", *table])))


def _challenges(runs: pd.DataFrame) -> int:
    return int(runs.groupby(PLACES, dropna=False).ngroups)


def _block(runs: pd.DataFrame, measure: str) -> pd.DataFrame:
    """Returns the rows of teachers that have results on the same challenges."""
    by = [*ACROSS, "teacher"]
    table = stratified_means(runs, measure)[[*by, "n", "difference", "low", "high"]]
    table = table.set_axis([*by, "n", "mean", "low_mean", "high_mean"], axis=1)
    chances = improvements(runs, measure, reference=BASELINE, within=ACROSS, strata=CHALLENGES)
    chances = chances.rename(columns={"first": "teacher"})[[*by, "value", "low", "high"]]
    chances = chances.set_axis([*by, "better", "low_better", "high_better"], axis=1)
    lowest = runs.groupby([*by, *CHALLENGES], dropna=False)[measure].min()
    worst = lowest.groupby(by, dropna=False).mean().rename("worst").reset_index()
    shares = profiles(runs, measure, THRESHOLDS, by=by, strata=CHALLENGES)
    wide = shares.pivot_table(index=by, columns="threshold", values="share", dropna=False, observed=True)
    wide = wide.rename(columns={threshold: f"over_{threshold}" for threshold in THRESHOLDS}).reset_index()
    for columns in (chances, worst, wide):
        table = table.merge(columns, on=by, how="left")
    order = [*[True] * len(ACROSS), False]
    return table.sort_values([*ACROSS, "mean"], ascending=order, ignore_index=True)


def overall_rows(runs: pd.DataFrame, measure: str = MEASURE) -> list[dict[str, Any]]:
    """Returns the rows of `overall` as text.

    Args:
        runs: rows of `pooling.pool_runs`.
        measure: column of `runs`, in per cent.

    Returns:
        place, name (of the teacher), teacher (its label), own (True if it is the reader's), colour, n, mean
        and better (with intervals), worst, over (shares of runs over `THRESHOLDS`).
    """
    if runs.empty:
        return []
    table = overall(runs, measure)
    told = ["steps", *(name for name in varying(runs) if name != "steps")]
    return [
        {
            "place": place_of(row, told),
            "name": row["teacher"],
            "teacher": marked_label(row["teacher"]),
            "own": mark_of(row["teacher"]) != "",
            "colour": look(row["teacher"]).colour,
            "n": row["n"],
            "mean": interval(row, "mean", 1),
            "better": interval(row, "better", 2),
            "worst": number(row["worst"]),
            "over": " / ".join(number(100 * row[f"over_{threshold}"], 0) for threshold in THRESHOLDS),
        }
        for _, row in table.iterrows()
    ]


def performance_profiles(runs: pd.DataFrame, measure: str = MEASURE) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yields where (level and budget, in words) and the performance profiles of all teachers there.

    Args:
        runs: rows of `pooling.pool_runs`.
        measure: column of `runs`, in per cent.

    Returns:
        Of `aggregates.profiles`, at `STEPS`.
    """
    if runs.empty:
        return
    told = ["steps", *(name for name in varying(runs) if name != "steps")]
    for _, group in runs[runs[measure].notna()].groupby(ACROSS, dropna=False, sort=True):
        for part, of in on_the_same(group):
            table = profiles(part, measure, STEPS, by=[*ACROSS, "teacher"], strata=CHALLENGES)
            row = part.iloc[0].copy()
            row["challenges"], row["of"] = _challenges(part), of
            yield place_of(row, told), table


def place_of(row: pd.Series, told: Sequence[str]) -> str:
    """Returns level and conditions of a row of `overall` in words, and its challenges where they are not all.

    Args:
        row: a row of `overall`.
        told: columns of `CONDITIONS` that are said.
    """
    words = [f"expert knowledge {row['expert_knowledge']}", *condition_words(row, told)]
    if row["challenges"] < row["of"]:
        words.append(f"{row['challenges']} of {row['of']} challenges")
    return ", ".join(words)


def interval(row: pd.Series, name: str, digits: int) -> str:
    """Returns the estimate `name` of a row of `overall` with its interval, as text."""
    return estimate(row[name], row[f"low_{name}"], row[f"high_{name}"], digits)
