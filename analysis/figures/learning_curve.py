"""Learning curves of one comparison, a figure of the report."""

from __future__ import annotations

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.figures.axes import percent_axis, step_axis
from analysis.figures.lines import draw_line
from analysis.measures import aggregate
from analysis.style import look, short_label, styled, teacher_order


@styled
def learning_curve(curves: pd.DataFrame, value: str, ylabel: str) -> Figure:
    """Draws the mean of `value` over seeds against steps, one line per teacher, ± one standard error.

    A line starts where all its runs have values, and is thin where some of them have yet to arrive.

    Args:
        curves: teacher, run_id, step and `value`, of one comparison.
        value: column to draw.
        ylabel: what it is, with its unit.
    """
    figure = Figure(figsize=(5.2, 3.5), layout="constrained")
    axes = figure.subplots()
    axes.grid(axis="y")
    table = aggregate(curves, value)
    for teacher in sorted(table["teacher"].unique(), key=teacher_order):
        draw_line(axes, table[table["teacher"] == teacher], look(teacher), short_label(teacher))
    step_axis(axes)
    axes.set_ylabel(ylabel)
    percent_axis(axes, value)
    _legend(figure, axes)
    return figure


def _legend(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        columns = max(1, min(4, 75 // (6 + max(map(len, labels)))))
        figure.legend(
            handles, labels, loc="outside upper left", ncols=columns, handlelength=2.4, columnspacing=1.4
        )
