"""The chart that opens a report: all comparisons at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import pandas as pd

from analysis.comparisons.few_seeds import caveat
from analysis.comparisons.findings import MASTERED
from analysis.comparisons.measured import Measured
from analysis.data.frames import GROUP
from analysis.pages.charts import Chart, overview_chart
from analysis.pages.report.comparison_charts import QUANTITIES, points_of
from analysis.pages.report.sections import titled


def overview(measured: Measured) -> Iterator[Chart]:
    """Yields the chart of a root with several comparisons, if any run was evaluated."""
    found = list(titled(measured))
    if len(found) < 2 or measured.finals.empty:
        return
    points = [points_of(mine, MASTERED.column).assign(comparison=anchor) for anchor, _, mine in found]
    rows = dict(
        zip((anchor for anchor, *_ in found), distinct([title for _, title, _ in found]), strict=True)
    )
    caption = "Marks are means over seeds, lines their 95 % intervals. Choose above what is shown and when."
    few = caveat(measured.finals.groupby(GROUP)["run_id"].nunique().min())
    caption += f" {few}" if few else ""
    yield overview_chart(
        pd.concat(points, ignore_index=True), rows, QUANTITIES[MASTERED.column], "All comparisons", caption
    )


def distinct(titles: Sequence[str]) -> list[str]:
    """Returns titles without the parts, between commas, that all of them share."""
    parts = [title.split(", ") for title in titles]
    shared = set.intersection(*map(set, parts)) if parts else set()
    return [", ".join(part for part in each if part not in shared) or ", ".join(each) for each in parts]
