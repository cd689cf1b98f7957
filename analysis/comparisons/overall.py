"""Results over all challenges at once: differences, interquartile means and probabilities of improvement."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from analysis.comparisons.aggregates import (
    ACROSS,
    CHALLENGES,
    improvements,
    interquartile_means,
    stratified_differences,
)
from analysis.data.reference import BASELINE
from analysis.formatting import number, p_value
from analysis.looks import look
from analysis.measures.conditions import CONDITIONS, condition_words, varying
from analysis.names import label
from analysis.statistics import SIGNIFICANCE

MEASURE = "mastered_percent"


def headlines(runs: pd.DataFrame) -> list[str]:
    """Returns a sentence on each teacher's difference to Random over all challenges, largest first.

    Few seeds of one challenge decide little, all challenges together more. A teacher is better or worse where
    p is under 0.05 after Holm's correction for all teachers at that level.

    Args:
        runs: of `pooling.pool_runs`.
    """
    if runs.empty:
        return []
    table = stratified_differences(runs, MEASURE, BASELINE)
    table = table[(table["reason"] == "") & (table["challenges"] > 1)]
    table = table.sort_values([*ACROSS, "difference"], ascending=[*[True] * len(ACROSS), False])
    told = {"steps", *varying(table), *(["variant"] if (table["variant"] != "").any() else [])}
    return [_headline(row, [name for name in CONDITIONS if name in told]) for _, row in table.iterrows()]


def _headline(row: pd.Series, told: list[str]) -> str:
    verdict = "not distinguishable from"
    if row["holm"] < SIGNIFICANCE:
        verdict = "better than" if row["difference"] > 0 else "worse than"
    interval = f"{number(row['difference'])} points [{number(row['low'])}, {number(row['high'])}]"
    return (
        f"Over {row['challenges']} challenges (expert knowledge {row['expert_knowledge']}, "
        f"{', '.join(condition_words(row, told))}) {label(row['teacher'])} is {verdict} Random: {interval}, "
        f"{p_value(row['holm'])} after Holm."
    )


def overall_rows(runs: pd.DataFrame) -> list[dict[str, Any]]:
    """Returns a row for each teacher at each level and budget, the best first, as text.

    Args:
        runs: of `pooling.pool_runs`.

    Returns:
        place, teacher, colour, n, mean (interquartile, of mastered tasks in per cent, with its 95 % interval
        `statistics.estimates`), better (probability that a run is better than one of Random on the same
        challenge, with interval), missing (what others have results of and this one has not).
    """
    if runs.empty:
        return []
    told = ["steps", *(name for name in varying(runs) if name != "steps")]
    means = interquartile_means(runs, MEASURE, by=[*ACROSS, "teacher"], strata=CHALLENGES)
    chances = improvements(runs, MEASURE, reference=BASELINE, within=ACROSS, strata=CHALLENGES)
    chances = chances.rename(columns={"first": "teacher"})
    table = means.merge(chances, on=[*ACROSS, "teacher"], how="left", suffixes=("", "_better"))
    table = table.sort_values([*ACROSS, "value"], ascending=[*[True] * len(ACROSS), False])
    return [
        {
            "place": ", ".join([f"expert knowledge {row['expert_knowledge']}", *condition_words(row, told)]),
            "teacher": label(row["teacher"]),
            "colour": look(row["teacher"]).colour,
            "n": row["n"],
            "mean": _interval(row, "", 1),
            "better": _interval(row, "_better", 2),
            "missing": row["missing"],
        }
        for _, row in table.iterrows()
        if row["n"]
    ]


def _interval(row: pd.Series, suffix: str, digits: int) -> str:
    value, low, high = (row[f"{name}{suffix}"] for name in ("value", "low", "high"))
    if not np.isfinite(value):
        return "\N{EN DASH}"
    if not np.isfinite(low):
        return number(value, digits)
    return f"{number(value, digits)} [{number(low, digits)}, {number(high, digits)}]"
