"""Figures of one experiment, seed by seed: final mastered %, and learning curves."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.figures.elements.axes import LEAST_PERCENT, percent_axis, step_axis
from analysis.figures.elements.lines import draw_line
from analysis.figures.style import styled
from analysis.formatting import amount
from analysis.looks import INK, look
from analysis.measures.evaluations import aggregate
from analysis.names import label, short_labels, teacher_order


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
