"""Learning curves of every pair of teachers, with stars where they differ."""

from __future__ import annotations

import itertools

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from analysis.figures.curves.matrix import difference_matrix
from analysis.figures.elements.axes import LEAST_PERCENT, percent_axis, share_step_label, step_axis
from analysis.figures.elements.checks import require, require_unique, significant
from analysis.figures.elements.legends import legend, mark_handle, teacher_handles
from analysis.figures.elements.lines import draw_line
from analysis.figures.style import ONE_COLUMN, TWO_COLUMNS, styled
from analysis.looks import MUTED, look
from analysis.names import label, short_labels, teacher_order

LARGEST = 9
"""With more rows of panels than these, a matrix of the last differences takes the place of curves."""

ROOMY = 3
"""With so many columns of panels the corner above them has room for the legend."""


@styled
def pairwise_curves(
    curves: pd.DataFrame,
    tests: pd.DataFrame,
    measure: str = "mastered_percent",
    name: str = "Mastered test tasks (%)",
) -> Figure:
    """Draws a panel for every pair of teachers, with mean ± standard error of both against steps.

    Stars along the top of a panel mark the steps at which the two differ significantly, in the colour of
    the one that is above. All panels have the same axes. Of more than `LARGEST` + 1
    teachers, `difference_matrix` shows their last step.

    Args:
        curves: of ``pooled(runs, [measure], by=["step"])`` for one comparison: teacher, step, n, and
            `measure` with the endings _mean and _std.
        tests: all pairs at every step, of `pairwise.pairwise` with step among `within`.
        measure: what is drawn.
        name: what that is, with its unit.

    Raises:
        ValueError: under two teachers, or several values of a teacher at a step.
    """
    table = _table(curves, measure)
    teachers = sorted(table["teacher"].unique(), key=teacher_order)
    if len(teachers) < 2:
        raise ValueError(f"curves of {len(teachers)} teachers: expected at least two, to compare them")
    size, tests = len(teachers) - 1, significant(tests)
    if size > LARGEST:
        return difference_matrix(table, tests, teachers, name)
    figure, grid = _grid(size)
    drawn, names = [], short_labels(teachers, 15)
    for row, column in itertools.product(range(size), repeat=2):
        axes = grid[row, column]
        if column > row:
            axes.remove()
            continue
        drawn.append(axes)
        pair = teachers[column], teachers[row + 1]
        _draw_pair(axes, table, pair, measure)
        _draw_stars(axes, tests, pair)
        if column == 0:
            axes.set_ylabel(names[pair[1]], fontsize=6.5, fontweight="bold")
        if row == column:
            axes.set_title(names[pair[0]], fontsize=6.5)
    share_step_label(figure, np.array(drawn))
    figure.supylabel(name, fontsize=8.5)
    _add_legend(figure, teachers, size)
    return figure


def _add_legend(figure: Figure, teachers: list[str], size: int) -> None:
    handles = teacher_handles(teachers, marker="")
    handles.append(mark_handle("*", "differ at this step (p < 0.05)", color=MUTED))
    if size < ROOMY:
        legend(figure, handles, "outside upper center")
    else:
        figure.legend(handles=handles, loc="upper right", fontsize=7, labelspacing=0.35)


def _table(curves: pd.DataFrame, measure: str) -> pd.DataFrame:
    """Returns teacher, step, n, mean and standard_error, sorted by step."""
    mean, std = f"{measure}_mean", f"{measure}_std"
    require(curves, ["teacher", "step", "n", mean, std], "curves")
    require_unique(curves, ["teacher", "step"], "curves")
    table = curves[["teacher", "step", "n"]].assign(mean=curves[mean].astype(float))
    table["standard_error"] = curves[std] / np.sqrt(curves["n"].astype(float))
    return table[table["mean"].notna()].sort_values("step")


def _draw_pair(axes: Axes, table: pd.DataFrame, pair: tuple[str, str], measure: str) -> None:
    """Draws two curves on axes that suit the whole table, with room for stars above."""
    for teacher in pair:
        rows = table[table["teacher"] == teacher]
        draw_line(axes, rows, look(teacher), label(teacher), width=0.9)
    error = table["standard_error"].fillna(0.0)
    low, high = min(0.0, (table["mean"] - error).min()), (table["mean"] + error).max()
    axes.set_ylim(low, max(high, low + LEAST_PERCENT))
    percent_axis(axes, measure)
    low, high = axes.get_ylim()
    axes.set_ylim(top=high + 0.16 * (high - low))
    step_axis(axes, table["step"].max(), ticks=2)


def _grid(size: int) -> tuple[Figure, np.ndarray]:
    width = ONE_COLUMN if size == 1 else TWO_COLUMNS
    height = 0.9 + (1.9 if size == 1 else min(1.5, (width - 0.6) / size * 0.9) * size)
    figure = Figure(figsize=(width, height), layout=ConstrainedLayoutEngine(hspace=0, wspace=0))
    grid = figure.subplots(size, size, sharex=True, sharey=True, squeeze=False)
    for axes in grid.ravel():
        axes.tick_params(labelsize=6, length=2)
    return figure, grid


def _draw_stars(axes: Axes, tests: pd.DataFrame, pair: tuple[str, str]) -> None:
    """Draws a star at each step at which two teachers differ, in the colour of the one above."""
    for above, below in (pair, pair[::-1]):
        there = (tests["first"] == above) & (tests["second"] == below) & (tests["difference"] > 0)
        here = (tests["first"] == below) & (tests["second"] == above) & (tests["difference"] < 0)
        steps = tests.loc[there | here, "step"].to_numpy(float)
        if not len(steps):
            continue
        axes.plot(
            steps,
            np.full(len(steps), 0.94),
            transform=axes.get_xaxis_transform(),
            linestyle="none",
            marker="*",
            markersize=3.2,
            markeredgewidth=0,
            clip_on=False,
            color=look(above).colour,
            gid=f"{above}-above-{below}",
        )
