"""Legends that lie outside of what they explain, as wide as the figure."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D

from analysis.charts.base import Curve, Interval, Key, Mark
from analysis.looks import Look

CHARACTER = 0.6
"""Width of a letter over its size."""

HANDLE, COLUMN_GAP = 2.6, 1.2
"""Length of the pieces of line, and space between columns, in sizes of the letters."""

POINTS = 72
"""Points in an inch."""


def line_handle(mark: Mark) -> Line2D:
    """Return a piece of the line of a named mark."""
    fill = mark.fill if isinstance(mark, Curve) else ""
    marked = not isinstance(mark, Curve) or mark.width >= 1.5
    look = mark.look if marked else mark.look._replace(marker="")
    return look_handle(look, mark.name, fill, line=not isinstance(mark, Interval))


def look_handle(look: Look, name: str, fill: str = "", line: bool = True) -> Line2D:
    """Return a piece of a line in its look, named."""
    edge = look.colour if fill and fill != look.colour else "white"
    style: dict[str, Any] = {"color": look.colour, "marker": look.marker, "markersize": 4, "linewidth": 1.3}
    style |= {
        "linestyle": look.dashes if line else "none",
        "markerfacecolor": fill or look.colour,
        "markeredgecolor": edge,
        "markeredgewidth": 0.5,
    }
    return Line2D([], [], label=name, **style)


def mark_handle(key: Key) -> Line2D:
    """Return a mark that means the same for all teachers, named."""
    inside = key.colour if key.full else "white"
    style: dict[str, Any] = {"color": key.colour, "markerfacecolor": inside, "markeredgewidth": 0.7}
    return Line2D([], [], marker=key.marker, linestyle="none", markersize=key.size, label=key.name, **style)


def legend(figure: Figure, handles: Sequence[Line2D], loc: Any, size: float = 7, **place: Any) -> Legend:
    """Draw one legend for the whole figure, in as many columns as its width has room for."""
    return figure.legend(
        handles=list(handles),
        loc=loc,
        ncols=_columns(handles, figure.get_figwidth(), size),
        fontsize=size,
        handlelength=HANDLE,
        columnspacing=COLUMN_GAP,
        handletextpad=0.5,
        labelspacing=0.35,
        borderpad=0.2,
        borderaxespad=0.2,
        **place,
    )


def legend_height(handles: Sequence[Line2D], width: float, size: float = 7) -> float:
    """Return the height of a `legend` in a figure of this width, inches."""
    rows = -(-len(handles) // _columns(handles, width, size))
    return (rows * 1.6 + 0.6) * size / POINTS if handles else 0.0


def _columns(handles: Sequence[Line2D], width: float, size: float) -> int:
    """Return the largest number of columns that fits."""
    em = size / POINTS
    widths = [(len(str(handle.get_label())) * CHARACTER + 0.5) * em for handle in handles]
    gaps = (HANDLE + COLUMN_GAP) * em
    for columns in range(len(widths), 1, -1):
        # Matplotlib fills columns one after the other, the first ones with one more.
        if sum(max(part) + gaps for part in np.array_split(widths, columns)) <= width - 0.1:
            return columns
    return 1
