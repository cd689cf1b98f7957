"""Figures that teachers log of themselves, such as losses, over the steps of a run."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.data.curricula import Curriculum
from analysis.figures.elements.axes import share_step_label, step_axis
from analysis.figures.style import styled
from analysis.looks import MUTED, look
from analysis.names import short_labels, teacher_order

COLUMNS = 4

MOST_PER_TEACHER = 8
"""Scalars of one teacher that are drawn, in the order of their names."""

BINS = 150
"""A longer series is drawn as the median of so many equal parts, within its range in each."""


def scalars_of(curriculum: Curriculum) -> dict[str, pd.Series]:
    """Returns the finite values of every scalar by its name, indexed by step."""
    rows = [
        (int(step), str(name), float(value))
        for step, scalars in zip(curriculum.updates["step"], curriculum.updates["scalars"], strict=True)
        for name, value in (scalars or ())
        if math.isfinite(value)
    ]
    table = pd.DataFrame(rows, columns=["step", "name", "value"])
    return {str(name): rows.set_index("step")["value"] for name, rows in table.groupby("name")}


@styled
def scalar_curves(curricula: Mapping[str, Curriculum]) -> Figure | None:
    """Draws one panel per teacher and scalar; None if no teacher logs any.

    Args:
        curricula: one run for each teacher.
    """
    panels = [
        (teacher, name, values)
        for teacher in sorted(curricula, key=teacher_order)
        for name, values in list(scalars_of(curricula[teacher]).items())[:MOST_PER_TEACHER]
    ]
    if not panels:
        return None
    columns = min(COLUMNS, len(panels))
    lines = -(-len(panels) // columns)
    figure = Figure(figsize=(0.4 + 2.45 * columns, 0.45 + 1.45 * lines), layout="constrained")
    grid = figure.subplots(lines, columns, squeeze=False)
    names = short_labels(curricula)
    longest = max(curriculum.steps for curriculum in curricula.values())
    for axes, (teacher, name, values) in zip(grid.ravel(), panels, strict=False):
        _curve(axes, values, look(teacher).colour)
        axes.set_title(f"{names[teacher]}\n", fontsize=8.5)
        axes.text(0, 1.05, name.replace("_", " "), transform=axes.transAxes, fontsize=8.5, color=MUTED)
        step_axis(axes, longest, ticks=5)
    share_step_label(figure, grid)
    for spare in grid.ravel()[len(panels) :]:
        spare.remove()
    return figure


def _curve(axes: Axes, values: pd.Series, colour: str) -> None:
    axes.grid(axis="y")
    if len(values) <= BINS:
        axes.plot(values.index, values, color=colour, linewidth=1.2, marker=".", markersize=3)
        return
    part = np.arange(len(values)) * BINS // len(values)
    binned = pd.DataFrame({"step": values.index, "value": values.to_numpy()}).groupby(part)
    steps, spread = binned["step"].median(), binned["value"].agg(["min", "median", "max"])
    axes.fill_between(steps, spread["min"], spread["max"], color=colour, alpha=0.25, linewidth=0)
    axes.plot(steps, spread["median"], color=colour, linewidth=1.2)
