"""Learning curves of one comparison, a figure of the report."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.figures.axes import LEAST_PERCENT, step_axis
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
        _curve(axes, teacher, table[table["teacher"] == teacher])
    step_axis(axes)
    axes.set_ylabel(ylabel)
    if value == "mastered_percent":
        axes.set_ylim(bottom=0)
        axes.set_ylim(top=max(axes.get_ylim()[1], LEAST_PERCENT))
    _legend(figure, axes)
    return figure


def _curve(axes: Axes, teacher: str, rows: pd.DataFrame) -> None:
    style = look(teacher)
    complete = (rows["n"] == rows["n"].max()).to_numpy()
    rows, complete = rows[complete.argmax() :], complete[complete.argmax() :]
    steps, mean = rows["step"].to_numpy(float), rows["mean"].to_numpy(float)
    error = rows["standard_error"].fillna(0.0).to_numpy(float)
    end = int(np.flatnonzero(complete)[-1])  # later steps were reached by some of the runs only
    axes.fill_between(steps, mean - error, mean + error, color=style.colour, alpha=0.18, linewidth=0)
    axes.plot(steps[end:], mean[end:], color=style.colour, linewidth=0.7)
    axes.plot(
        steps[: end + 1],
        mean[: end + 1],
        color=style.colour,
        linestyle=style.dashes,
        marker=style.marker,
        markevery=max(1, (end + 1) // 8),
        markeredgecolor="white",
        markeredgewidth=0.5,
        clip_on=False,
        zorder=3,
        label=short_label(teacher),
    )


def _legend(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        columns = max(1, min(4, 75 // (6 + max(map(len, labels)))))
        figure.legend(
            handles, labels, loc="outside upper left", ncols=columns, handlelength=2.4, columnspacing=1.4
        )
