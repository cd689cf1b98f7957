"""Chart of a trial: differences from the references at its interim looks, with decision boundaries."""

from collections.abc import Iterable, Iterator, Mapping

import numpy as np
import pandas as pd

from analysis.charts.base import TWO_COLUMNS, Chart, Curve, Panel, PanelAxis, ReferenceLine
from analysis.comparisons.verdicts import AXES
from analysis.names import label, marked_label
from analysis.teacher_styles import INK, MUTED, TeacherStyle, teacher_style

BOUNDARY, BAND = TeacherStyle(INK, "", (0, (4, 2))), TeacherStyle(MUTED, "", "-")
"""Styles of boundaries and of the margin."""

ROOM = 1.4  # reach of the vertical axis, in units of the furthest boundary after the first look


def course_chart(
    courses: Mapping[tuple[str, str], pd.DataFrame],
    teacher: str,
    margins: Mapping[str, float],
    name: str = "course",
) -> Chart:
    """Return a panel per comparison: differences with intervals by look, boundaries, equivalence margin.

    Args:
        courses: rows of `trials.interim.course` by measure and reference, with a row of panels per measure.
        teacher: new teacher.
        margins: equivalence margin of each measure, in points.
        name: identifier of the chart.
    """
    panels: dict[str, list[Panel]] = {}
    for (measure, reference), table in courses.items():
        margin = margins[measure]
        seeds, seen = table["seeds"].astype(float), table[table["value"].notna()]
        later = table.loc[seeds > seeds.min(), ["better", "worse"]].abs().to_numpy().max()
        reach = ROOM * float(max(later, margin, seen["value"].abs().max() if len(seen) else 0.0))
        x = PanelAxis(
            "Seeds of every cell", low=float(seeds.min()) - 1, high=float(seeds.max()) + 1, whole=True
        )
        y = PanelAxis("Difference (points)", low=-reach, high=reach, grid=True)
        title = _heading(measure, [reference]) if len(courses) > 1 else ""
        width = np.array([seeds.iloc[0] - 1, seeds.iloc[-1] + 1])
        band = Curve(x=width, low=np.full(2, -margin), high=np.full(2, margin), look=BAND)
        marks = [band, ReferenceLine(y=0.0, look=BAND, width=0.8), *_course(table, seen, teacher, 2 * reach)]
        panels.setdefault(measure, []).append(Panel(x, y, marks, title))
    caption = (
        "Difference with its repeated confidence interval at each look. Over the upper boundary the teacher "
        "is better, under the lower one worse, and alike where all of the interval is in the grey band. "
        "Boundaries of looks to come are those that the release's spread lets expect."
    )
    measures, references = (dict.fromkeys(names) for names in zip(*courses, strict=True))
    heading = " and ".join(_heading(measure, references) for measure in measures)
    return Chart(name, [*panels.values()], heading, caption, size=(TWO_COLUMNS, 2.9 * len(panels)))


def _heading(measure: str, references: Iterable[str]) -> str:
    """Return a heading with the measure and the references."""
    return f"{AXES[measure].capitalize()}, against {' and '.join(map(label, references))}"


def _course(table: pd.DataFrame, seen: pd.DataFrame, teacher: str, reach: float) -> Iterator[Curve]:
    """Yield the curves of boundaries and of observed differences with intervals, clipped to ± `reach`."""
    for side, name in (("better", "boundary of a verdict"), ("worse", "")):
        bounds = np.clip(table[side].to_numpy(float), -reach, reach)
        seeds, hover = table["seeds"].to_numpy(float), f"{side} beyond {{y:.1f}}"
        yield Curve(x=seeds, y=bounds, look=BOUNDARY, width=1.2, name=name, hover=hover)
    style = teacher_style(teacher)
    for x, low, high in seen[["seeds", "low", "high"]].to_numpy(float):
        ends = np.clip([low, high], -reach, reach)
        yield Curve(x=np.full(2, x), y=ends, look=style._replace(dashes="-"), width=1.4)
    if len(seen):
        yield Curve(
            x=seen["seeds"].to_numpy(float),
            y=seen["value"].to_numpy(float),
            look=style,
            name=marked_label(teacher),
            hover="{y:.1f} after {x} seeds",
        )
