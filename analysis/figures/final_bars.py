"""Final mastered % of one comparison, seed by seed, a figure of the report."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from analysis.figures.axes import LEAST_PERCENT
from analysis.formatting import amount
from analysis.style import INK, label, look, short_label, styled


@styled
def final_bars(reading: pd.DataFrame) -> Figure:
    """Draws mean ± standard deviation of final mastered %, one bar per teacher and one dot per seed.

    A teacher whose runs are all under way is labelled with the step it is read at.

    Args:
        reading: teacher, run_id, step, provisional and mastered_percent, of one comparison.
    """
    means = reading.groupby("teacher")["mastered_percent"].agg(["mean", "std"])
    order = sorted(means.index, key=lambda teacher: (means.loc[teacher, "mean"], label(teacher).lower()))
    figure = Figure(figsize=(5.2, 0.9 + 0.42 * len(order)), layout="constrained")
    axes = figure.subplots()
    axes.grid(axis="x")
    for row, teacher in enumerate(order):
        mean, std = means.loc[teacher]
        colour = look(teacher).colour
        seeds = reading.loc[reading["teacher"] == teacher, "mastered_percent"].sort_values().to_numpy()
        axes.barh(row, mean, height=0.62, color=colour, alpha=0.35)
        if np.isfinite(std):
            axes.errorbar(mean, row, xerr=std, color=INK, capsize=3, linewidth=1.0, capthick=1.0)
        spread = np.linspace(-0.2, 0.2, len(seeds)) if len(seeds) > 1 else np.zeros(1)
        axes.scatter(seeds, row + spread, s=15, color=colour, edgecolor="white", linewidth=0.4, zorder=3)
    running = reading[reading["provisional"]].groupby("teacher")["step"].max()
    notes = [f"\nat {amount(running[teacher])} steps" if teacher in running else "" for teacher in order]
    names = [short_label(teacher) + note for teacher, note in zip(order, notes, strict=True)]
    axes.set_yticks(range(len(order)), names)
    axes.tick_params(axis="y", length=0)
    axes.set_xlim(0, max(LEAST_PERCENT, axes.get_xlim()[1]))
    axes.set_xlabel("Mastered test tasks (%)")
    return figure
