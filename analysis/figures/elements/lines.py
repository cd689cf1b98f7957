"""One line of a learning curve."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from analysis.looks import Look


def draw_line(
    axes: Axes, rows: pd.DataFrame, look: Look, label: str, fill: str | None = None, width: float = 1.6
) -> None:
    """Draws mean ± standard error against steps.

    The line starts where all runs have values, and is thin where some of them have yet to arrive.

    Args:
        axes: where to.
        rows: step (rising), n, mean and standard_error (NaN for none).
        look: colour, marker and dashes.
        label: for a legend.
        fill: colour inside markers; that of the line if None.
        width: of the line, points; lines under 1.2 have no markers.
    """
    rows = rows[rows["mean"].notna()]
    if rows.empty:
        return
    complete = (rows["n"] == rows["n"].max()).to_numpy()
    rows, complete = rows[complete.argmax() :], complete[complete.argmax() :]
    steps, mean = rows["step"].to_numpy(float), rows["mean"].to_numpy(float)
    error = rows["standard_error"].fillna(0.0).to_numpy(float)
    end = int(np.flatnonzero(complete)[-1])  # later steps were reached by some of the runs only
    axes.fill_between(steps, mean - error, mean + error, color=look.colour, alpha=0.18, linewidth=0)
    axes.plot(steps[end:], mean[end:], color=look.colour, linewidth=0.7)
    axes.plot(
        steps[: end + 1],
        mean[: end + 1],
        color=look.colour,
        linestyle=look.dashes,
        linewidth=width,
        marker=look.marker if width >= 1.2 else "",
        markevery=max(1, (end + 1) // 8),
        markerfacecolor=fill or look.colour,
        markeredgecolor=look.colour if fill else "white",
        markeredgewidth=0.5,
        clip_on=False,
        zorder=3,
        label=label,
    )
