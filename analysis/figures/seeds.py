"""Results of one comparison: maps of mastered test tasks, bars with seeds, learning curves."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from analysis.data.curricula import Axis
from analysis.figures.elements import LEAST_PERCENT, draw_line, percent_axis, step_axis
from analysis.figures.style import styled
from analysis.formatting import amount
from analysis.looks import INK, MUTED, RULE, look
from analysis.measures.evaluations import aggregate
from analysis.names import label, short_labels, teacher_order

SHARE_COLOURS = "Blues"
"""From paper white for nobody to dark for every seed; readable with any colour vision."""


@styled
def mastery_map(shares: pd.DataFrame, tasks: pd.DataFrame, plane: tuple[Axis, Axis] | None) -> Figure:
    """Draws which test tasks are mastered by which share of seeds, one panel per teacher.

    On the task plane if the tasks form a grid on it, else one row per teacher and one column per task.

    Args:
        shares: teacher, task_index and share, of one comparison and one test set.
        tasks: task_index and task (float32 (d,)) of the test set.
        plane: the two dimensions of the tasks; None when they have more, or nobody knows.
    """
    teachers = sorted(shares["teacher"].unique(), key=teacher_order)
    grid = _grid(tasks)
    if grid is None or plane is None:
        return _mastery_rows(shares, teachers)
    xs, ys, columns, rows = grid
    figure, panels = _panels(len(teachers))
    names = short_labels(teachers, 14)
    for axes, teacher in zip(panels, teachers, strict=True):
        mine = shares[shares["teacher"] == teacher].set_index("task_index")["share"]
        image = np.full((len(ys), len(xs)), np.nan)
        image[rows, columns] = mine.reindex(tasks["task_index"]).to_numpy()
        mesh = axes.pcolormesh(
            xs,
            ys,
            image,
            cmap=SHARE_COLOURS,
            vmin=0,
            vmax=1,
            shading="nearest",
            edgecolor=RULE,
            linewidth=0.4,
        )
        axes.set_title(f"{names[teacher]}   {100 * np.nanmean(image):.1f} %")
        for spine in axes.spines.values():
            spine.set_visible(False)
    figure.supxlabel(plane[0].name, fontsize=8.5)
    figure.supylabel(plane[1].name, fontsize=8.5)
    _share_bar(figure, mesh, panels)
    return figure


def _panels(count: int) -> tuple[Figure, list[Axes]]:
    """Returns a figure with `count` square panels that share their axes, at most four in a row."""
    columns = min(count, 4)
    lines = -(-count // columns)
    side = 2.75 if count < 4 else 2.25
    figure = Figure(figsize=(side * columns + 1.2, (side + 0.1) * lines + 0.55), layout="constrained")
    panels = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False).ravel().tolist()
    for spare in panels[count:]:
        spare.remove()
    return figure, panels[:count]


def _mastery_rows(shares: pd.DataFrame, teachers: list[str]) -> Figure:
    """Draws one row per teacher; tasks from the most to the least mastered over all teachers."""
    table = shares.pivot_table(index="teacher", columns="task_index", values="share").loc[teachers]
    order = table.mean().sort_values(ascending=False, kind="stable").index
    figure = Figure(figsize=(10.2, 1.0 + 0.3 * len(teachers)), layout="constrained")
    axes = figure.subplots()
    mesh = axes.pcolormesh(table[order].to_numpy(), cmap=SHARE_COLOURS, vmin=0, vmax=1)
    names = short_labels(teachers)
    axes.set_yticks(np.arange(len(teachers)) + 0.5, [names[teacher] for teacher in teachers])
    axes.invert_yaxis()
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("Test tasks, from the most to the least often mastered")
    _share_bar(figure, mesh, [axes])
    return figure


def _share_bar(figure: Figure, mesh: ScalarMappable, panels: list[Axes]) -> None:
    bar = figure.colorbar(mesh, ax=panels, format=PercentFormatter(1.0), fraction=0.05, pad=0.02, aspect=22)
    bar.set_label("Seeds that master the task")
    bar.outline.set_visible(False)
    bar.ax.tick_params(color=MUTED)


def _grid(tasks: pd.DataFrame) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
    """Returns axes and cell indices if the tasks are a full two-dimensional grid, else None."""
    points = np.stack(tasks["task"].to_list()) if len(tasks) else np.empty((0, 0))
    if points.shape[1] != 2:
        return None
    xs, columns = np.unique(points[:, 0], return_inverse=True)
    ys, rows = np.unique(points[:, 1], return_inverse=True)
    full = len(xs) * len(ys) == len(np.unique(points, axis=0)) == len(points)
    return (xs, ys, columns, rows) if full and min(len(xs), len(ys)) > 1 else None


@styled
def final_bars(finals: pd.DataFrame) -> Figure:
    """Draws mean ± standard deviation of final mastered %, one bar per teacher and one dot per seed.

    A teacher whose runs are all under way is labelled with the step it is read at.

    Args:
        finals: teacher, run_id, step, provisional and mastered_percent, of one comparison.
    """
    means = finals.groupby("teacher")["mastered_percent"].agg(["mean", "std"])
    order = sorted(means.index, key=lambda teacher: (means.loc[teacher, "mean"], label(teacher).lower()))
    figure = Figure(figsize=(5.2, 0.9 + 0.42 * len(order)), layout="constrained")
    axes = figure.subplots()
    axes.grid(axis="x")
    for row, teacher in enumerate(order):
        mean, std = means.loc[teacher]
        colour = look(teacher).colour
        seeds = finals.loc[finals["teacher"] == teacher, "mastered_percent"].sort_values().to_numpy()
        axes.barh(row, mean, height=0.62, color=colour, alpha=0.35)
        if np.isfinite(std):
            axes.errorbar(mean, row, xerr=std, color=INK, capsize=3, linewidth=1.0, capthick=1.0)
        spread = np.linspace(-0.2, 0.2, len(seeds)) if len(seeds) > 1 else np.zeros(1)
        axes.scatter(seeds, row + spread, s=15, color=colour, edgecolor="white", linewidth=0.4, zorder=3)
    running = finals[finals["provisional"]].groupby("teacher")["step"].max()
    notes = [f"\nat {amount(running[teacher])} steps" if teacher in running else "" for teacher in order]
    short = short_labels(order)
    names = [short[teacher] + note for teacher, note in zip(order, notes, strict=True)]
    axes.set_yticks(range(len(order)), names)
    axes.tick_params(axis="y", length=0)
    axes.set_xlim(0, max(LEAST_PERCENT, axes.get_xlim()[1]))
    axes.set_xlabel("Mastered test tasks (%)")
    return figure


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
    names = short_labels(table["teacher"])
    for teacher in sorted(names, key=teacher_order):
        draw_line(axes, table[table["teacher"] == teacher], look(teacher), names[teacher])
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
