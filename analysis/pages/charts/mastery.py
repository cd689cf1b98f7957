"""Test tasks that are mastered, by share of seeds: a chart for each teacher."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from numpy.typing import NDArray

from analysis.data.curricula import stack
from analysis.data.task_axes import Axis
from analysis.names import teacher_order
from analysis.pages.charts.chart import END, Chart, figure_of, named, step_frame, task_axis

HEIGHT = 270

COLOURS = "Blues"
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
    for teacher in sorted(map(str, shares["teacher"].unique()), key=teacher_order):
        mine = shares[shares["teacher"] == teacher]
        percent = {step: _percent(mine[mine["step"].eq(step)], tasks) for step in mine["step"].unique()}
        size = float(np.clip(ACROSS / np.sqrt(len(tasks)), 4, 24))
        trace = go.Scatter(
            x=points[:, 0].round(4),
            y=points[:, 1].round(4),
            mode="markers",
            marker={
                "symbol": "square",
                "size": size,
                "color": percent.get(END, []),
                "cmin": 0,
                "cmax": 100,
                "colorscale": COLOURS,
                "line": {"color": "#c3c9d1", "width": 0.5},
            },
            text=words,
            hovertemplate="task %{text}<br>%{marker.color} % of seeds<extra></extra>",
        )
        frames = [
            step_frame(step, {0: {"marker": {"color": values}}}, _title(teacher, values))
            for step, values in percent.items()
        ]
        layout = {**_axes(axes if plane else ()), "title": _heading(_title(teacher, percent.get(END, [])))}
        figure = figure_of([trace], HEIGHT, layout, frames)
        yield Chart(f"{prefix}-{teacher}", "Which test tasks are mastered", caption, figure, teacher)


def _percent(rows: pd.DataFrame, tasks: pd.DataFrame) -> list[float]:
    values = 100 * rows.set_index("task_index")["share"].reindex(tasks["task_index"]).to_numpy(float)
    return [round(float(value), 1) for value in values]


def _title(teacher: str, percent: list[float]) -> str:
    known = [value for value in percent if np.isfinite(value)]
    return f"{named(teacher)}   {np.mean(known):.1f} %" if known else named(teacher)


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
    side = int(np.ceil(np.sqrt(len(tasks))))
    return np.column_stack([rank % side, -(rank // side)]).astype(np.float64), False


def _axes(plane: tuple[Axis, ...]) -> dict[str, object]:
    if not plane:
        return {"xaxis": {"visible": False}, "yaxis": {"visible": False}}
    return {f"{letter}axis": task_axis(dimension) for letter, dimension in zip("xy", plane, strict=True)}
