"""Axes that several figures have in common."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

LEAST_PERCENT = 5.0
"""Axes of mastered % reach at least this far, so that one task of a hundred never looks like a triumph."""


def step_axis(axes: Axes, high: float | None = None, ticks: int = 6) -> None:
    """Makes the horizontal axis one of training steps, in the unit that suits their number.

    Args:
        axes: where the steps are drawn.
        high: last step; that of the data if None.
        ticks: at most so many intervals.
    """
    high = max(axes.dataLim.x1, 1.0) if high is None else high
    unit, word = next(
        ((size, name) for size, name in ((1e6, "millions"), (1e3, "thousands")) if high >= 2 * size),
        (1.0, ""),
    )
    axes.set_xlim(0, high)
    axes.xaxis.set_major_locator(MaxNLocator(ticks))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda step, _: f"{step / unit:g}"))
    axes.set_xlabel(f"Training steps ({word})" if word else "Training steps")


def percent_axis(axes: Axes, measure: str) -> None:
    """Lets the vertical axis of a percentage start at 0 and reach `LEAST_PERCENT`; leaves others alone."""
    if measure.endswith("percent"):
        axes.set_ylim(bottom=0)
        axes.set_ylim(top=max(axes.get_ylim()[1], LEAST_PERCENT))


def share_step_label(figure: Figure, grid: np.ndarray) -> None:
    """Names the steps once below a grid of panels that all have a `step_axis`."""
    labels = [axes.get_xlabel() for axes in grid.ravel()]
    for axes in grid.ravel():
        axes.set_xlabel("")
    figure.supxlabel(max(labels, key=len), fontsize=8.5)
