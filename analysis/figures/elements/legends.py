"""Legends that lie outside of what they explain, as wide as the figure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D

from analysis.looks import INK, look
from analysis.names import short_labels, teacher_order

CHARACTER = 0.6
"""Width of a letter over its size."""

HANDLE, COLUMN_GAP = 2.6, 1.2
"""Length of the pieces of line, and space between columns, in sizes of the letters."""

POINTS = 72
"""Points in an inch."""


def teacher_handles(teachers: Iterable[str], **changes: Any) -> list[Line2D]:
    """Returns a piece of the line of each of `teachers`, under names that tell them apart."""
    names = short_labels(teachers)
    return [
        teacher_handle(teacher, names[teacher], **changes) for teacher in sorted(names, key=teacher_order)
    ]


def teacher_handle(teacher: str, name: str, **changes: Any) -> Line2D:
    """Returns a piece of the line of `teacher`, named."""
    style = look(teacher)
    shown: dict[str, Any] = {"color": style.colour, "marker": style.marker, "linestyle": style.dashes}
    shown |= {"label": name, "linewidth": 1.3, "markersize": 4, "markeredgewidth": 0.5}
    return Line2D([], [], **(shown | {"markeredgecolor": "white"} | changes))


def mark_handle(marker: str, label: str, **changes: Any) -> Line2D:
    """Returns a mark that means the same for all teachers, named."""
    shown: dict[str, Any] = {"color": INK, "marker": marker, "linestyle": "none", "markersize": 5}
    return Line2D([], [], **(shown | {"label": label, "markeredgewidth": 0.7} | changes))


def legend(figure: Figure, handles: Sequence[Line2D], loc: Any, size: float = 7, **place: Any) -> Legend:
    """Draws one legend for the whole figure, in as many columns as its width has room for.

    Args:
        figure: what is explained.
        handles: with labels.
        loc: as of `Figure.legend`.
        size: of the letters, points.
        place: further arguments of `Figure.legend`.
    """
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
    """Returns the height of a `legend` in a figure of this width, inches."""
    rows = -(-len(handles) // _columns(handles, width, size))
    return (rows * 1.6 + 0.6) * size / POINTS if handles else 0.0


def _columns(handles: Sequence[Line2D], width: float, size: float) -> int:
    """Returns the largest number of columns that fits."""
    em = size / POINTS
    widths = [(len(str(handle.get_label())) * CHARACTER + 0.5) * em for handle in handles]
    gaps = (HANDLE + COLUMN_GAP) * em
    for columns in range(len(widths), 1, -1):
        # Matplotlib fills columns one after the other, the first ones with one more.
        if sum(max(part) + gaps for part in np.array_split(widths, columns)) <= width - 0.1:
            return columns
    return 1
