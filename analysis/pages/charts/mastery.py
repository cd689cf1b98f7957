"""Test tasks that are mastered, by share of seeds: a chart for each teacher."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.data.curricula import stack
from analysis.data.task_axes import Axis
from analysis.names import short_labels, teacher_order
from analysis.pages.charts.chart import (
    END,
    LONGEST,
    Chart,
    Trace,
    drawing_of,
    heatmap,
    scale,
    scatter,
    shown,
    step_frame,
    task_axis,
)

HEIGHT = 270

COLOURS = scale("Blues")
"""From nearly white for nobody to dark for every seed."""

ACROSS = 180
"""Room for the tasks' marks, CSS pixels."""


def mastery_charts(
    prefix: str, shares: pd.DataFrame, tasks: pd.DataFrame, axes: tuple[Axis, ...], caption: str
) -> Iterator[Chart]:
    """Yields a chart of the test tasks for each teacher: a mark for each, darker for more seeds.

    On the task plane where tasks have two dimensions, else in a square, the tasks that most seeds master
    first.

    Args:
        prefix: of the charts' names.
        shares: teacher, step (of an evaluation, or `END`), task_index, n and share (in [0, 1]).
        tasks: task_index and task (float32 (d,)) of the test set.
        axes: the dimensions of the task space.
        caption: of how many seeds.
    """
    tasks = tasks.sort_values("task_index", ignore_index=True)
    points, plane = _places(shares, tasks, axes)
    words = [", ".join(f"{value:.4g}" for value in task) for task in stack(tasks["task"])]
    cells = _Cells.of(points) if plane else None
    names = short_labels(shares["teacher"], LONGEST)
    for teacher in sorted(names, key=teacher_order):
        mine = shares[shares["teacher"] == teacher]
        percent = {step: _percent(rows, tasks) for step, rows in mine.groupby("step", sort=False)}
        ends = percent.get(END, [math.nan] * len(tasks))
        trace = _marks(points, ends, words) if cells is None else cells.trace(ends, words)
        frames = [
            step_frame(
                step,
                {
                    0: {"marker": {"color": values}}
                    if cells is None
                    else {"type": "heatmap", "z": cells.filled(values)}
                },
                _title(names[teacher], values),
            )
            for step, values in percent.items()
        ]
        layout = {**_axes(axes if plane else ()), "title": _heading(_title(names[teacher], ends))}
        drawing = drawing_of([trace], HEIGHT, layout, frames)
        yield Chart(f"{prefix}-{teacher}", "Which test tasks are mastered", caption, drawing, teacher)


@dataclass(frozen=True, eq=False)
class _Cells:
    """A full grid of tasks on the task plane: coordinates, and the column and row of each task."""

    xs: NDArray[np.float64]
    ys: NDArray[np.float64]
    columns: NDArray[np.int64]
    rows: NDArray[np.int64]

    @classmethod
    def of(cls, points: NDArray[np.float64]) -> _Cells | None:
        xs, columns = np.unique(points[:, 0], return_inverse=True)
        ys, rows = np.unique(points[:, 1], return_inverse=True)
        full = len(xs) * len(ys) == len(np.unique(points, axis=0)) == len(points)
        return cls(xs, ys, columns, rows) if full and min(len(xs), len(ys)) > 1 else None

    def filled(self, values: Sequence[Any]) -> list[list[Any]]:
        """Returns values of tasks by row and column."""
        table = np.empty((len(self.ys), len(self.xs)), dtype=object)
        table[self.rows, self.columns] = [None if pd.isna(value) else value for value in values]
        return [list(row) for row in table]

    def trace(self, percent: Sequence[float], words: Sequence[str]) -> Trace:
        """Returns a map that fills its chart, however wide that is."""
        return heatmap(
            x=self.xs.round(4),
            y=self.ys.round(4),
            z=self.filled(percent),
            text=self.filled(words),
            zmin=0,
            zmax=100,
            colorscale=COLOURS,
            showscale=False,
            xgap=1,
            ygap=1,
            hovertemplate="task %{text}<br>%{z} % of seeds<extra></extra>",
        )


def _marks(points: NDArray[np.float64], percent: Sequence[float], words: Sequence[str]) -> Trace:
    """Returns a mark for each task."""
    return scatter(
        x=points[:, 0].round(4),
        y=points[:, 1].round(4),
        mode="markers",
        marker={
            "symbol": "square",
            "size": float(np.clip(ACROSS / np.sqrt(len(points)), 4, 24)),
            "color": percent,
            "cmin": 0,
            "cmax": 100,
            "colorscale": COLOURS,
            "line": {"color": "#c3c9d1", "width": 0.5},
        },
        text=words,
        hovertemplate="task %{text}<br>%{marker.color} % of seeds<extra></extra>",
    )


def _percent(rows: pd.DataFrame, tasks: pd.DataFrame) -> list[float]:
    places = pd.Index(tasks["task_index"]).get_indexer(rows["task_index"])
    values = np.full(len(tasks), np.nan)
    values[places[places >= 0]] = 100 * rows["share"].to_numpy(float)[places >= 0]
    return [round(float(value), 1) for value in values]


def _title(name: str, percent: list[float]) -> str:
    known = [value for value in percent if np.isfinite(value)]
    return f"{shown(name)}   {np.mean(known):.1f} %" if known else shown(name)


def _heading(text: str) -> dict[str, object]:
    return {"text": text, "font": {"size": 13}, "x": 0.02, "xanchor": "left", "y": 0.97}


def _places(
    shares: pd.DataFrame, tasks: pd.DataFrame, axes: tuple[Axis, ...]
) -> tuple[NDArray[np.float64], bool]:
    """Returns where each task's mark lies (n, 2), and whether that is the task plane."""
    values = stack(tasks["task"]).astype(np.float64)
    if len(axes) == 2 == values.shape[1]:
        return values, True
    mean = shares[shares["step"] == END].groupby("task_index")["share"].mean().reindex(tasks["task_index"])
    rank = np.argsort(np.argsort(-mean.fillna(-1).to_numpy(), kind="stable"), kind="stable")
    side = int(np.ceil(np.sqrt(2 * len(tasks))))  # charts are wider than high
    return np.column_stack([rank % side, -(rank // side)]).astype(np.float64), False


def _axes(plane: tuple[Axis, ...]) -> dict[str, object]:
    if not plane:
        return {"xaxis": {"visible": False}, "yaxis": {"visible": False}}
    return {f"{letter}axis": task_axis(dimension) for letter, dimension in zip("xy", plane, strict=True)}
