"""Elements that figures share: axes, legends, lines, panels of a task plane, checks of tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, MaxNLocator

from analysis.data.curricula import Axis
from analysis.looks import INK, MUTED, Look, look
from analysis.names import order, short_labels, teacher_order, title
from analysis.statistics import SIGNIFICANCE
from tma_ray.tasks import KnowledgeLevel

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


def require(table: pd.DataFrame, columns: Sequence[str], what: str) -> None:
    """Checks that a table has rows and columns.

    Raises:
        ValueError: it has no rows, or lacks one of `columns`.
    """
    absent = [column for column in columns if column not in table]
    if absent:
        raise ValueError(f"{what}: expected the columns {', '.join(columns)}; {', '.join(absent)} not there")
    if table.empty:
        raise ValueError(f"expected {what} with at least one row: there is nothing to draw")


def require_unique(table: pd.DataFrame, keys: Sequence[str], what: str) -> None:
    """Checks that no two rows claim the same place in a figure.

    Raises:
        ValueError: two rows have the same `keys`.
    """
    twice = table[table.duplicated(list(keys))]
    if len(twice):
        place = ", ".join(str(value) for value in twice.iloc[0][list(keys)])
        raise ValueError(
            f"{what}: expected one row for each {', '.join(keys)}, found several of {place}; select one "
            f"of the experiments, steps, bodies or students that are mixed there"
        )


def significant(tests: pd.DataFrame) -> pd.DataFrame:
    """Returns the rows of `tests` with a p-value under 0.05 after Holm's correction; NaN is none."""
    return tests[tests["holm"] < SIGNIFICANCE]


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


Line = tuple[str, str]
"""A teacher and a level of expert knowledge."""

_DASHES: dict[str, str | tuple[int, tuple[int, ...]]] = {
    KnowledgeLevel.NONE.value: (0, (1, 1)),
    KnowledgeLevel.LOW.value: (0, (4, 2)),
    KnowledgeLevel.HIGH.value: "-",
}
_PALE = {KnowledgeLevel.NONE.value: 1.0, KnowledgeLevel.LOW.value: 0.6, KnowledgeLevel.HIGH.value: 0.0}


def line_order(line: Line) -> tuple[tuple[bool, bool, str], tuple[int, str]]:
    """Sorts lines by teacher, then by level."""
    return teacher_order(line[0]), order("expert_knowledge", line[1])


class LineLooks:
    """How the lines of one figure are told apart: by teacher, and by level where there are several."""

    def __init__(self, lines: Iterable[Line]) -> None:
        self.lines = sorted(set(lines), key=line_order)
        self._names = short_labels(teacher for teacher, _ in self.lines)
        self._several_teachers = len(self._names) > 1
        self._several_levels = len({level for _, level in self.lines}) > 1

    def name(self, line: Line) -> str:
        """Returns what the legend calls a line."""
        teacher, level = line
        if not self._several_levels:
            return self._names[teacher]
        told = title("expert_knowledge", level)
        return f"{self._names[teacher]}, {told.lower()}" if self._several_teachers else told

    def look(self, line: Line) -> Look:
        """Returns colour, marker and dashes of a line."""
        style = look(line[0])
        return style._replace(dashes=_DASHES.get(line[1], "-")) if self._several_levels else style

    def fill(self, line: Line) -> str:
        """Returns the colour inside its markers, paler for less knowledge."""
        pale = _PALE.get(line[1], 0.0) if self._several_levels else 0.0
        red, green, blue = (part + (1 - part) * pale for part in to_rgb(look(line[0]).colour))
        return to_hex((red, green, blue))

    def handle(self, line: Line) -> Line2D:
        """Returns a piece of the line for a legend."""
        style = self.look(line)
        changes: dict[str, Any] = {"markerfacecolor": self.fill(line), "markeredgecolor": style.colour}
        return teacher_handle(line[0], self.name(line), linestyle=style.dashes, **changes)


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


def label_plane(figure: Figure, axes: Axes, plane: tuple[Axis, Axis]) -> None:
    """Names the axes that all panels of `figure` share, and gives them the task space's bounds."""
    axes.set_xlim(plane[0].low, plane[0].high)
    axes.set_ylim(plane[1].low, plane[1].high)
    figure.supxlabel(plane[0].name, fontsize=8.5)
    figure.supylabel(plane[1].name, fontsize=8.5)


def frame(axes: Axes) -> None:
    """Draws a light frame around a small panel."""
    for spine in axes.spines.values():
        spine.set_visible(True)
        spine.set_color("#b9bec6")
    axes.tick_params(length=2)


def remark(axes: Axes, text: str) -> None:
    """Says in the middle of an empty panel why it is empty."""
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color=MUTED)
