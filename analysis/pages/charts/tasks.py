"""Tasks at any step: what teachers teach, and which test tasks are mastered."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.data.curricula import PANELS, Axis, Curriculum, boxes_of, gaussians_of, return_range, stack
from analysis.looks import INK, RETURN_COLOURS, look
from analysis.names import short_labels, teacher_order
from analysis.pages.charts.chart import (
    END,
    LONGEST,
    Chart,
    Trace,
    axis,
    drawing_of,
    heatmap,
    named,
    scale,
    scatter,
    shown,
    step_frame,
    task_axis,
    transparent,
)

Array = NDArray[np.float64]

Outline = tuple[Array, Array]
"""xs and ys of a closed line."""

CORNERS = 33
"""Points of an ellipse."""

BOX, GAUSSIAN = 0.3, 0.2
"""Half the width of either in a dimension's column."""

GOLDEN = 0.618034
"""Multiples of it, less their whole part, spread evenly however many there are."""


@dataclass(frozen=True)
class TaskView:
    """How tasks are shown: on the task plane where it has two dimensions that vary.

    Else in a column for each dimension that varies, at their share of its range.

    Attributes:
        axes: the dimensions of the task space.
    """

    axes: tuple[Axis, ...]

    @property
    def varied(self) -> list[int]:
        """Places of the dimensions that vary."""
        return [place for place, dimension in enumerate(self.axes) if dimension.low < dimension.high]

    @property
    def plane(self) -> bool:
        """Whether tasks are points of a plane."""
        return len(self.axes) == len(self.varied) == 2

    def dots(self, tasks: Array) -> tuple[list[float], list[float]]:
        """Returns xs and ys of `tasks` (n, d): one dot each on a plane, else one in every column."""
        if self.plane:
            return rounded(tasks[:, 0]), rounded(tasks[:, 1])
        spread = 0.16 * (2 * ((np.arange(len(tasks)) * GOLDEN) % 1) - 1)
        columns = np.arange(len(self.varied)) + spread[:, None]
        return rounded(columns.ravel()), rounded(self._shares(tasks).ravel())

    def boxes(self, boxes: Iterable[Mapping[str, Any]]) -> dict[str, list[float | None]]:
        """Returns the outlines of boxes (low, high) as xs and ys of one trace."""
        ends = [[np.asarray(box[end], np.float64) for end in ("low", "high")] for box in boxes]
        if self.plane:
            return _joined(_rectangle(low, high) for low, high in ends)
        return _joined(outline for low, high in ends for outline in self._spans(low, high, BOX))

    def gaussians(self, gaussians: Iterable[Mapping[str, Any]]) -> dict[str, list[float | None]]:
        """Returns the outlines of Gaussians (mean, covariance), at two standard deviations, as `boxes`."""
        outlines: list[Outline] = []
        for gaussian in gaussians:
            mean = np.asarray(gaussian["mean"], dtype=np.float64)
            covariance = np.array([list(row) for row in gaussian["covariance"]], dtype=np.float64)
            if self.plane:
                outlines.append(_ellipse(mean, covariance))
            else:
                reach = 2 * np.sqrt(np.maximum(np.diag(covariance), 0.0))
                outlines += self._spans(mean - reach, mean + reach, GAUSSIAN)
        return _joined(outlines)

    def layout(self) -> dict[str, Any]:
        """Returns the axes of a chart."""
        if self.plane:
            return {
                f"{letter}axis": task_axis(each) | {"range": [each.low, each.high]}
                for letter, each in zip("xy", self.axes, strict=True)
            }
        names = [shown(self.axes[place].name.partition(" (")[0]) for place in self.varied]
        places = list(range(len(names)))
        return {
            "xaxis": axis(tickvals=places, ticktext=names, range=[-0.5, len(names) - 0.5], showgrid=False),
            "yaxis": axis("Share of the range", range=[-0.02, 1.02], tickformat=".0%"),
        }

    def _shares(self, tasks: Array) -> Array:
        """Returns varied dimensions of tasks (…, d) as shares of their ranges (…, v)."""
        low, high = np.array([[self.axes[place].low, self.axes[place].high] for place in self.varied]).T
        return np.asarray((tasks[..., self.varied] - low) / (high - low), dtype=np.float64)

    def _spans(self, low: Array, high: Array, half: float) -> list[Outline]:
        ends = np.clip(self._shares(np.stack([low, high])), 0.0, 1.0)
        return [
            _rectangle(np.array([column - half, bottom]), np.array([column + half, top]))
            for column, (bottom, top) in enumerate(ends.T)
        ]


def rounded(values: Sequence[float] | Array) -> list[float]:
    """Returns values with as many digits as a reader can tell apart."""
    return [float(f"{value:.4g}") for value in values]


def _rectangle(low: Array, high: Array) -> Outline:
    (left, bottom), (right, top) = low, high
    return np.array([left, right, right, left, left]), np.array([bottom, bottom, top, top, bottom])


def _ellipse(mean: Array, covariance: Array) -> Outline:
    angles = np.linspace(0, 2 * np.pi, CORNERS)
    values, vectors = np.linalg.eigh(covariance)
    circle = np.stack([np.cos(angles), np.sin(angles)])
    edge = vectors @ (2 * np.sqrt(np.maximum(values, 0.0))[:, None] * circle)
    return mean[0] + edge[0], mean[1] + edge[1]


def _joined(outlines: Iterable[Outline]) -> dict[str, list[float | None]]:
    """Returns outlines as one trace, with a gap after each."""
    xs: list[float | None] = []
    ys: list[float | None] = []
    for x, y in outlines:
        xs += [*rounded(x), None]
        ys += [*rounded(y), None]
    return {"x": xs, "y": ys}


HEIGHT = 290
"""CSS pixels."""

MOMENTS, DOTS = 24, 60
"""At most this many steps of a run, and this many probed tasks of a step."""

EPISODES = 150
"""At most this many training episodes of a part of a run, evenly spaced in time."""


def probed_task_charts(
    prefix: str, curricula: Mapping[str, Curriculum], axes: tuple[Axis, ...], caption: str
) -> Iterator[Chart]:
    """Yields what each teacher would teach: probed tasks, and the Gaussians and boxes behind them.

    Args:
        prefix: of the charts' names.
        curricula: one run for each teacher; without probes it has no chart.
        axes: the dimensions of the task space.
        caption: which runs they are.
    """
    view, names = TaskView(axes), named(curricula)
    for teacher in sorted(curricula, key=teacher_order):
        curriculum = curricula[teacher]
        steps = _probed_steps(curriculum)
        if not steps or not view.varied:
            continue
        states = [_state(curriculum, step, view) for step in steps]
        frames = [step_frame(step, dict(enumerate(state))) for step, state in zip(steps, states, strict=True)]
        looks = _looks(teacher, _hover(view))
        traces = [scatter(**own, **patch) for own, patch in zip(looks, states[-1], strict=True)]
        drawing = drawing_of(traces, HEIGHT, view.layout() | {"title": _heading(names[teacher])}, frames)
        yield Chart(f"{prefix}-{teacher}", "Probed tasks", caption, drawing, teacher)


def training_task_charts(
    prefix: str, curricula: Mapping[str, Curriculum], axes: tuple[Axis, ...], caption: str
) -> Iterator[Chart]:
    """Yields what each teacher taught: training episodes of a part of the run, coloured by return.

    Args:
        prefix: of the charts' names.
        curricula: one run for each teacher; without episodes it has no chart.
        axes: the dimensions of the task space.
        caption: which runs they are.
    """
    view, names = TaskView(axes), named(curricula)
    shown = {teacher: each for teacher, each in curricula.items() if len(each.episodes)}
    if not shown or not view.varied:
        return
    low, high = return_range(shown, next(iter(shown.values())).mastery)
    colours = {"cmin": low, "cmax": high, "colorscale": scale(RETURN_COLOURS), "size": 6}
    for teacher in sorted(shown, key=teacher_order):
        parts = {
            round(shown[teacher].steps * (part + 1) / PANELS): _episodes(shown[teacher].during(part), view)
            for part in range(PANELS)
        }
        there = {step: part for step, part in parts.items() if part["x"]}
        if not there:
            continue
        last = there[max(there)]
        trace = scatter(
            **{**last, "marker": {**colours, **last["marker"], "line": {"color": INK, "width": 0.3}}},
            mode="markers",
            hovertemplate=f"{_hover(view)}<br>return %{{marker.color}}<extra></extra>",
        )
        frames = [step_frame(step, {0: part}) for step, part in there.items()]
        drawing = drawing_of([trace], HEIGHT, view.layout() | {"title": _heading(names[teacher])}, frames)
        yield Chart(f"{prefix}-{teacher}", "Training tasks", caption, drawing, teacher)


def _probed_steps(curriculum: Curriculum) -> list[int]:
    steps = np.unique(curriculum.probes["step"].to_numpy(np.int64))
    chosen = np.unique(np.linspace(0, len(steps) - 1, min(MOMENTS, len(steps))).round().astype(int))
    return [int(steps[index]) for index in chosen] if len(steps) else []


def _looks(teacher: str, hover: str) -> list[dict[str, Any]]:
    colour = look(teacher).colour
    shape = {"mode": "lines", "hoverinfo": "skip", "fill": "toself"}
    return [
        shape | {"line": {"color": colour, "width": 1.2}, "fillcolor": transparent(colour, 0.08)},
        shape | {"line": {"color": colour, "width": 1.6}, "fillcolor": transparent(colour, 0.13)},
        {
            "mode": "markers",
            "marker": {"size": 5, "color": INK, "opacity": 0.75, "line": {"color": "white", "width": 0.5}},
            "hovertemplate": f"{hover}<extra></extra>",
        },
    ]


def _state(curriculum: Curriculum, step: int, view: TaskView) -> list[dict[str, Any]]:
    """Returns boxes, Gaussians and probed tasks at a step, as parts of traces."""
    tasks, update = curriculum.probed_at(step)[:DOTS].astype(np.float64), curriculum.update_at(step)
    boxes = [] if update is None else boxes_of(update)
    gaussians = [] if update is None else gaussians_of(update)
    xs, ys = view.dots(tasks)
    return [view.boxes(boxes), view.gaussians(gaussians), {"x": xs, "y": ys}]


def _episodes(part: Curriculum, view: TaskView) -> dict[str, Any]:
    count = len(part.episodes)
    chosen = np.unique(np.linspace(0, max(count - 1, 0), EPISODES).round().astype(int))[: max(count, 0)]
    tasks = (part.tasks if count else stack(part.episodes["task"]))[chosen].astype(np.float64)
    returns = part.episodes["episodic_return"].to_numpy(np.float64)[chosen].round(1)
    xs, ys = view.dots(tasks) if count else ([], [])
    each = 1 if view.plane else len(view.varied)
    return {"x": xs, "y": ys, "marker": {"color": np.repeat(returns, each).tolist()}}


def _hover(view: TaskView) -> str:
    return "task %{x}, %{y}" if view.plane else "%{y} of the range"


def _heading(name: str) -> dict[str, Any]:
    return {"text": name, "font": {"size": 13}, "x": 0.02, "xanchor": "left", "y": 0.97}


MASTERY_HEIGHT = 270

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
        drawing = drawing_of([trace], MASTERY_HEIGHT, layout, frames)
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
