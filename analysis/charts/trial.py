"""The course of a trial: the difference to each reference at each look, and how far a verdict is."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
import pandas as pd

from analysis.charts.base import LONGEST_NAME, TWO_COLUMNS, Chart, Curve, Mark, Panel, Rule, Scale
from analysis.looks import INK, MUTED, Look, look
from analysis.names import label, short_labels

BOUNDARY, BAND = Look(INK, "", (0, (4, 2))), Look(MUTED, "", "-")
"""Looks of what a verdict needs, and of the margin."""

ROOM = 1.4
"""Height of a panel over the furthest boundary after the first look, which may be far away."""


def course_chart(
    courses: Mapping[str, pd.DataFrame], teacher: str, margin: float, name: str = "course"
) -> Chart:
    """Return a panel for each comparison: boundaries, margin, differences with their intervals.

    Args:
        courses: rows of `trials.standing.course` by reference.
        teacher: new teacher.
        margin: difference in points that does not matter.
        name: identifier of the chart.
    """
    panels = []
    for reference, table in courses.items():
        seeds, seen = table["seeds"].astype(float), table[table["value"].notna()]
        later = table.loc[seeds > seeds.min(), ["better", "worse"]].abs().to_numpy().max()
        reach = ROOM * float(max(later, margin, seen["value"].abs().max() if len(seen) else 0.0))
        x = Scale("Seeds of every cell", low=float(seeds.min()) - 1, high=float(seeds.max()) + 1, whole=True)
        y = Scale("Difference (points)", low=-reach, high=reach, grid=True)
        title = f"Against {label(reference)}" if len(courses) > 1 else ""
        panels.append(Panel(x, y, list(_marks(table, teacher, margin, reach)), title))
    caption = (
        "Difference with its repeated confidence interval at each look. Over the upper boundary the teacher "
        "is better, under the lower one worse, and alike where all of the interval is in the grey band. "
        "Boundaries of looks to come are those that the release's spread lets expect."
    )
    heading = "Against " + " and ".join(map(label, courses))
    return Chart(name, [panels], heading, caption, size=(TWO_COLUMNS, 2.9))


def _marks(table: pd.DataFrame, teacher: str, margin: float, reach: float) -> Iterator[Mark]:
    seeds = table["seeds"].to_numpy(float)
    width = np.array([seeds[0] - 1, seeds[-1] + 1])
    yield Curve(x=width, low=np.full(2, -margin), high=np.full(2, margin), look=BAND)
    yield Rule(y=0.0, look=BAND, width=0.8)
    for side in ("better", "worse"):
        bounds = np.clip(table[side].to_numpy(float), -2 * reach, 2 * reach)
        yield Curve(
            x=seeds,
            y=bounds,
            look=BOUNDARY,
            width=1.2,
            name="boundary of a verdict" if side == "better" else "",
            hover=f"{side} beyond {{y:.1f}}",
        )
    seen = table[table["value"].notna()]
    style = look(teacher)
    for place, low, high in seen[["seeds", "low", "high"]].to_numpy(float):
        ends = np.clip([low, high], -2 * reach, 2 * reach)
        yield Curve(x=np.full(2, place), y=ends, look=style._replace(dashes="-"), width=1.4)
    if len(seen):
        yield Curve(
            x=seen["seeds"].to_numpy(float),
            y=seen["value"].to_numpy(float),
            look=style,
            name=short_labels([teacher], LONGEST_NAME)[teacher],
            hover="{y:.1f} after {x} seeds",
        )
