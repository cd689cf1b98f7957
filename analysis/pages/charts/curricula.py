"""Training tasks and probed tasks at any step: a chart for each teacher."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from analysis.data.curricula import PANELS, Curriculum, boxes_of, gaussians_of, return_range, stack
from analysis.data.task_axes import Axis
from analysis.looks import INK, RETURN_COLOURS, look
from analysis.names import teacher_order
from analysis.pages.charts.chart import (
    Chart,
    drawing_of,
    named,
    scale,
    scatter,
    step_frame,
    transparent,
)
from analysis.pages.charts.task_view import TaskView

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
