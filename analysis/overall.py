"""Results over all challenges at once: interquartile means and probabilities of improvement."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from analysis.aggregates import ACROSS, CHALLENGES, improvements, interquartile_means
from analysis.formatting import amount, number
from analysis.measures import BASELINE
from analysis.style import label, look

MEASURE = "mastered_percent"


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
    means = interquartile_means(runs, MEASURE, by=[*ACROSS, "teacher"], strata=CHALLENGES)
    chances = improvements(runs, MEASURE, reference=BASELINE, within=ACROSS, strata=CHALLENGES)
    chances = chances.rename(columns={"first": "teacher"})
    table = means.merge(chances, on=[*ACROSS, "teacher"], how="left", suffixes=("", "_better"))
    table = table.sort_values([*ACROSS, "value"], ascending=[*[True] * len(ACROSS), False])
    return [
        {
            "place": f"expert knowledge {row['expert_knowledge']}, {amount(row['steps'])} steps",
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
