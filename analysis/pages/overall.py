"""The section of a page that puts all challenges together: a table of estimates, and performance profiles."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pandas as pd

from analysis.comparisons.few_seeds import caveat
from analysis.comparisons.overall import THRESHOLDS, overall_rows, performance_profiles
from analysis.measures.pooling import COMPARED
from analysis.measures.tested import MEASURE, QUANTITIES
from analysis.pages.charts import Chart, profile_chart
from analysis.pages.charts.profiles import FEWEST

CAPTION = (
    "Share of runs that master more of the test tasks than the horizontal axis says; bands are exact 95 % "
    f"intervals, threshold by threshold, of {FEWEST} runs and more; all challenges together."
)


@dataclass(frozen=True, eq=False)
class Overall:
    """What the section shows.

    Attributes:
        rows: of `overall_rows`.
        over: the thresholds of its last column, as text.
        charts: performance profiles, one for each level and budget.
        quantity: that is aggregated, as charts call it.
        caveat: where a teacher has few runs of a challenge; else empty.
    """

    rows: list[dict[str, Any]]
    over: str
    charts: list[Chart]
    quantity: str
    caveat: str


def overall_section(runs: pd.DataFrame, measure: str = MEASURE) -> Overall:
    """Returns the section on all runs that count as results, of `pooling.pool_runs`."""
    over = " / ".join(map(str, THRESHOLDS))
    return Overall(
        overall_rows(runs, measure),
        over,
        list(_charts(runs, measure)),
        QUANTITIES[measure],
        _caveat(runs, measure),
    )


def _caveat(runs: pd.DataFrame, measure: str) -> str:
    counted = runs[runs[measure].notna()]
    return caveat(counted.groupby([*COMPARED, "teacher"], dropna=False)["run_id"].nunique().min())


def _charts(runs: pd.DataFrame, measure: str) -> Iterator[Chart]:
    for count, (where, table) in enumerate(performance_profiles(runs, measure), start=1):
        title = f"Performance profiles, {where}"
        yield profile_chart(f"profiles-{count}", table, QUANTITIES[measure], title, CAPTION)
