"""Results over all challenges at once: differences, interquartile means, improvements, profiles."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from analysis.comparisons.aggregates import (
    ACROSS,
    CHALLENGES,
    improvements,
    interquartile_means,
    profiles,
    stratified_differences,
)
from analysis.comparisons.few_seeds import in_brief
from analysis.data.reference import BASELINE
from analysis.formatting import ends, number, p_value
from analysis.looks import look
from analysis.measures.conditions import CONDITIONS, condition_words, varying
from analysis.measures.tested import MEASURE
from analysis.names import label
from analysis.statistics import SIGNIFICANCE

THRESHOLDS = (25, 50, 75)
"""Per cent of the test tasks, over which the share of runs is told in tables."""

STEPS = tuple(range(0, 100, 2))
"""The same of the curves that are performance profiles."""


def headlines(runs: pd.DataFrame, measure: str = MEASURE) -> list[str]:
    """Returns a sentence on each teacher's difference to Random over all challenges, largest first.

    Few seeds of one challenge decide little, all challenges together more. A teacher is better or worse where
    p is under 0.05 after Holm's correction for all teachers at that level.

    Args:
        runs: of `pooling.pool_runs`.
        measure: column of `runs`, in per cent.
    """
    if runs.empty:
        return []
    table = stratified_differences(runs, measure, BASELINE)
    table = table[(table["reason"] == "") & (table["challenges"] > 1)]
    table = table.sort_values([*ACROSS, "difference"], ascending=[*[True] * len(ACROSS), False])
    told = {"steps", *varying(table), *(["variant"] if (table["variant"] != "").any() else [])}
    return [_headline(row, [name for name in CONDITIONS if name in told]) for _, row in table.iterrows()]


def _headline(row: pd.Series, told: list[str]) -> str:
    verdict = "not distinguishable from"
    if row["holm"] < SIGNIFICANCE:
        verdict = "better than" if row["difference"] > 0 else "worse than"
    interval = f"{number(row['difference'])} points {ends(row['low'], row['high'])}"
    return (
        f"Over {row['challenges']} challenges (expert knowledge {row['expert_knowledge']}, "
        f"{', '.join(condition_words(row, told))}) {label(row['teacher'])} is {verdict} Random: {interval}, "
        f"{p_value(row['holm'])} after Holm{in_brief(row['fewest'])}."
    )


def overall(runs: pd.DataFrame, measure: str = MEASURE) -> pd.DataFrame:
    """Returns one row for each teacher at each level and budget, over all its challenges, the best first.

    Args:
        runs: of `pooling.pool_runs`.
        measure: column of `runs`, in per cent.

    Returns:
        `ACROSS`, teacher, n, missing (what others have results of and this one has not), and with their 95 %
        intervals value, low, high: interquartile mean over all runs; value_better, low_better, high_better:
        probability that a run is better than one of Random on the same challenge (Agarwal et al., 2021);
        worst: of the worst run, the mean over challenges; over_25 and so on: share of runs over so many per
        cent.
    """
    by = [*ACROSS, "teacher"]
    means = interquartile_means(runs, measure, by=by, strata=CHALLENGES)
    chances = improvements(runs, measure, reference=BASELINE, within=ACROSS, strata=CHALLENGES)
    chances = chances.rename(columns={"first": "teacher"}).drop(columns=["measure", "second"])
    table = means.merge(chances, on=by, how="left", suffixes=("", "_better"))
    lowest = runs.groupby([*by, *CHALLENGES], dropna=False)[measure].min()
    worst = lowest.groupby(by, dropna=False).mean().rename("worst").reset_index()
    shares = profiles(runs, measure, THRESHOLDS, by=by, strata=CHALLENGES)
    wide = shares.pivot_table(index=by, columns="threshold", values="share", dropna=False, observed=True)
    wide = wide.rename(columns={threshold: f"over_{threshold}" for threshold in THRESHOLDS}).reset_index()
    table = table.merge(worst, on=by, how="left").merge(wide, on=by, how="left")
    order = [*[True] * len(ACROSS), False]
    return table[table["n"] > 0].sort_values([*ACROSS, "value"], ascending=order, ignore_index=True)


def overall_rows(runs: pd.DataFrame, measure: str = MEASURE) -> list[dict[str, Any]]:
    """Returns the rows of `overall` as text.

    Args:
        runs: of `pooling.pool_runs`.
        measure: column of `runs`, in per cent.

    Returns:
        place, name (of the teacher), teacher (its label), colour, n, mean and better (with intervals), worst,
        over (shares of runs over `THRESHOLDS`), missing.
    """
    if runs.empty:
        return []
    table = overall(runs, measure)
    told = ["steps", *(name for name in varying(runs) if name != "steps")]
    return [
        {
            "place": ", ".join([f"expert knowledge {row['expert_knowledge']}", *condition_words(row, told)]),
            "name": row["teacher"],
            "teacher": label(row["teacher"]),
            "colour": look(row["teacher"]).colour,
            "n": row["n"],
            "mean": interval(row, "", 1),
            "better": interval(row, "_better", 2),
            "worst": number(row["worst"]),
            "over": " / ".join(number(100 * row[f"over_{threshold}"], 0) for threshold in THRESHOLDS),
            "missing": row["missing"],
        }
        for _, row in table.iterrows()
    ]


def performance_profiles(runs: pd.DataFrame, measure: str = MEASURE) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yields where (level and budget, in words) and the performance profiles of all teachers there.

    Args:
        runs: of `pooling.pool_runs`.
        measure: column of `runs`, in per cent.

    Returns:
        Of `aggregates.profiles`, at `STEPS`.
    """
    if runs.empty:
        return
    told = ["steps", *(name for name in varying(runs) if name != "steps")]
    table = profiles(runs, measure, STEPS, by=[*ACROSS, "teacher"], strata=CHALLENGES)
    for _, rows in table[table["n"] > 0].groupby(ACROSS, dropna=False, sort=True):
        first = rows.iloc[0]
        yield (
            ", ".join([f"expert knowledge {first['expert_knowledge']}", *condition_words(first, told)]),
            rows,
        )


def interval(row: pd.Series, suffix: str, digits: int) -> str:
    """Returns an estimate of `overall` with its interval, as text."""
    value, low, high = (row[f"{name}{suffix}"] for name in ("value", "low", "high"))
    if not np.isfinite(value):
        return "\N{EN DASH}"
    if not np.isfinite(low):
        return number(value, digits)
    return f"{number(value, digits)} [{number(low, digits)}, {number(high, digits)}]"
