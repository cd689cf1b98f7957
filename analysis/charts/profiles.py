"""Charts of performance profiles and of the scalars in teachers' logs."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from analysis.charts.base import LONGEST_NAME, STEPS, AxisKind, Chart, Curve, Mark, Panel, PanelAxis, grid
from analysis.data.curricula import Curriculum
from analysis.names import short_labels
from analysis.teacher_styles import teacher_style

FEWEST = 5  # least number of runs of a line with a band, which would else fill the panel
MOST_PER_TEACHER = 8  # largest number of scalars per teacher
BINS = 150  # number of equal parts of a longer series, drawn as their medians and ranges


def profile_chart(table: pd.DataFrame, quantity: str, name: str, heading: str, caption: str) -> Chart:
    """Return the share of runs over each threshold, as a line per teacher.

    Args:
        table: teacher, threshold, share, low, high and n, of `aggregates.profiles`.
        quantity: title of the axis of thresholds.
        name: identifier of the chart.
        heading: title of the chart.
        caption: content and number of runs.
    """
    marks: list[Mark] = []
    for teacher, label in short_labels(table["teacher"].astype(str), LONGEST_NAME).items():
        rows = table[table["teacher"] == teacher].sort_values("threshold")
        share, low, high = (100 * rows[column].to_numpy(np.float64) for column in ("share", "low", "high"))
        band: dict[str, Any] = {"low": low, "high": high} if rows["n"].min() >= FEWEST else {}
        words = [f"{y:.0f} % [{a:.0f}, {b:.0f}]" for y, a, b in zip(share, low, high, strict=True)]
        marks.append(
            Curve(
                x=rows["threshold"].to_numpy(np.float64),
                y=share,
                **band,
                look=teacher_style(teacher)._replace(marker=""),
                name=label,
                teacher=teacher,
                words=words,
                hover="{text}",
                opacity=0.1,
            )
        )
    axes = (
        PanelAxis(quantity, low=0.0, high=100.0),
        PanelAxis("Runs over it (%)", low=-2.0, high=102.0, grid=True),
    )
    return Chart(name, [[Panel(*axes, marks)]], heading, caption)


def scalars_of(curriculum: Curriculum) -> dict[str, pd.Series]:
    """Return the finite values of each scalar by name, indexed by step."""
    rows = [
        (int(step), str(name), float(value))
        for step, scalars in zip(curriculum.updates["step"], curriculum.updates["scalars"], strict=True)
        for name, value in (scalars or ())
        if math.isfinite(value)
    ]
    table = pd.DataFrame(rows, columns=["step", "name", "value"])
    return {str(name): rows.set_index("step")["value"] for name, rows in table.groupby("name")}


def scalar_chart(curricula: Mapping[str, Curriculum], name: str, caption: str) -> Chart | None:
    """Return a panel per scalar, at most `MOST_PER_TEACHER` per teacher."""
    panels = []
    for teacher, label in short_labels(curricula, LONGEST_NAME).items():
        for scalar, values in list(scalars_of(curricula[teacher]).items())[:MOST_PER_TEACHER]:
            whole = bool(values.max() - values.min() < 5 and (values % 1 == 0).all())
            axes = PanelAxis(STEPS, AxisKind.STEPS), PanelAxis(whole=whole, grid=True)
            heading = label, scalar.replace("_", " ")
            panels.append(Panel(*axes, [_series(teacher, values)], *heading, teacher=teacher))
    rows = grid(panels, 4)
    size = 10.2, 0.4 + 1.8 * len(rows)
    return Chart(name, rows, "Teachers' logs", caption, size=size, pixels=230) if panels else None


def hidden_scalars(curricula: Mapping[str, Curriculum]) -> int:
    """Return the number of scalars that are not drawn."""
    counts = (len(scalars_of(curriculum)) for curriculum in curricula.values())
    return sum(max(0, count - MOST_PER_TEACHER) for count in counts)


def _series(teacher: str, values: pd.Series) -> Curve:
    look_of_line, hover = teacher_style(teacher)._replace(marker="", dashes="-"), "{y:.4g} at step {x:,d}"
    style: dict[str, Any] = {"look": look_of_line, "teacher": teacher, "width": 1.5, "hover": hover}
    if len(values) <= BINS:
        return Curve(x=values.index.to_numpy(np.float64), y=values.to_numpy(np.float64), **style)
    part = np.arange(len(values)) * BINS // len(values)
    binned = pd.DataFrame({"step": values.index, "value": values.to_numpy()}).groupby(part)
    low, median, high = (binned["value"].agg(name).to_numpy(np.float64) for name in ("min", "median", "max"))
    steps = binned["step"].median().to_numpy(np.float64)
    return Curve(x=steps, y=median, low=low, high=high, opacity=0.2, **style)
