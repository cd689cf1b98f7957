"""Marks of training tasks, probed tasks, and teachers' boxes and Gaussians in the task space."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from analysis.charts import base
from analysis.data.curricula import PANELS, Axis, RunCurriculum, boxes_of, gaussians_of, return_range
from analysis.names import short_labels
from analysis.teacher_styles import INK, RETURN_COLOURS, teacher_style

MOMENTS, DOTS = 24, 60  # maximum numbers of steps per run and of probed tasks per step, on a page

PAGE_EPISODES, PAPER_EPISODES = 150, 300
"""Largest number of training episodes drawn per part of a run, on a page and on paper."""

CORNERS = 33  # number of points that outline an ellipse
BOX, GAUSSIAN = 0.3, 0.2  # half-widths of boxes and Gaussians in a dimension's column
GOLDEN = 0.618034  # golden ratio - 1, whose multiples modulo 1 are spread evenly


def task_axis(axis: Axis) -> base.PanelAxis:
    """Return the axis of a dimension of the task space."""
    return base.PanelAxis(axis.name, base.AxisKind.TASK, axis.low, axis.high)


@dataclass(frozen=True)
class TaskView:
    """Mapping of tasks to coordinates in a panel: on the task plane, or in a column per varied dimension."""

    axes: Sequence[Axis]

    @property
    def varied(self) -> list[int]:
        """Indices of the dimensions that vary."""
        return [index for index, axis in enumerate(self.axes) if axis.low < axis.high]

    @property
    def plane(self) -> bool:
        """True if the task space is a plane."""
        return len(self.axes) == len(self.varied) == 2

    @property
    def hover(self) -> str:
        """Template of a task's hover text."""
        return "task {x}, {y}" if self.plane else "{y} of the range"

    def scales(self) -> tuple[base.PanelAxis, base.PanelAxis]:
        """Return the horizontal and the vertical axis of a panel."""
        if self.plane:
            return task_axis(self.axes[0]), task_axis(self.axes[1])
        names = {str(index): self.axes[index].name.partition(" (")[0] for index in self.varied}
        share = base.PanelAxis("Share of the range", base.AxisKind.SHARE, -0.02, 1.02, grid=True)
        return base.PanelAxis(kind=base.AxisKind.NAMES, rows=names), share

    def dots(self, tasks: base.Array) -> tuple[base.Array, base.Array]:
        """Return x and y of tasks (n, d): a point per task on a plane, else a point per task and column."""
        tasks = np.asarray(tasks, np.float64)
        if not len(tasks):
            return np.empty(0), np.empty(0)
        if self.plane:
            return tasks[:, 0], tasks[:, 1]
        jitter = 0.16 * (2 * ((np.arange(len(tasks)) * GOLDEN) % 1) - 1)
        return (np.arange(len(self.varied)) + jitter[:, None]).ravel(), self._shares(tasks).ravel()

    def boxes(self, boxes: Sequence[Mapping[str, Any]]) -> list[base.Outline]:
        """Return the outlines of boxes (low, high, score), in the order given."""
        outlines = []
        for box in boxes:
            low, high = (np.asarray(box[end], np.float64) for end in ("low", "high"))
            score = float(box["score"]) if len(boxes) > 1 else None
            shapes = [_rectangle(low, high)] if self.plane else self._spans(low, high, BOX)
            outlines += [base.Outline(*shape, weight=0.6, score=score) for shape in shapes]
        return outlines

    def gaussians(self, gaussians: Sequence[Mapping[str, Any]]) -> list[base.Outline]:
        """Return the outlines of Gaussians (weight, mean, covariance) at two standard deviations."""
        outlines: list[base.Outline] = []
        heaviest = max((float(gaussian["weight"]) for gaussian in gaussians), default=1.0)
        for gaussian in gaussians:
            mean = np.asarray(gaussian["mean"], dtype=np.float64)
            covariance = np.array([list(row) for row in gaussian["covariance"]], dtype=np.float64)
            weight = float(gaussian["weight"]) / heaviest if heaviest > 0 else 1.0
            if self.plane:
                outlines.append(base.Outline(*ellipse(mean, covariance), weight=weight))
            else:
                reach = 2 * np.sqrt(np.maximum(np.diag(covariance), 0.0))
                spans = self._spans(mean - reach, mean + reach, GAUSSIAN)
                outlines += [base.Outline(*span, weight=weight) for span in spans]
        return outlines

    def _shares(self, tasks: base.Array) -> base.Array:
        """Return the v varied dimensions of tasks (…, d), normalised to [0, 1], as an array (…, v)."""
        low, high = np.array([[self.axes[index].low, self.axes[index].high] for index in self.varied]).T
        return np.asarray((tasks[..., self.varied] - low) / (high - low), dtype=np.float64)

    def _spans(self, low: base.Array, high: base.Array, half: float) -> list[tuple[base.Array, base.Array]]:
        ends = np.clip(self._shares(np.stack([low, high])), 0.0, 1.0)
        return [
            _rectangle(np.array([column - half, bottom]), np.array([column + half, top]))
            for column, (bottom, top) in enumerate(ends.T)
        ]


def ellipse(mean: base.Array, covariance: base.Array) -> tuple[base.Array, base.Array]:
    """Return x and y coordinates of a Gaussian's two-sigma ellipse, from mean (2,) and covariance (2, 2)."""
    angles = np.linspace(0, 2 * np.pi, CORNERS)
    values, vectors = np.linalg.eigh(covariance)
    circle = np.stack([np.cos(angles), np.sin(angles)])
    edge = vectors @ (2 * np.sqrt(np.maximum(values, 0.0))[:, None] * circle)
    return mean[0] + edge[0], mean[1] + edge[1]


def _rectangle(low: base.Array, high: base.Array) -> tuple[base.Array, base.Array]:
    (left, bottom), (right, top) = low, high
    return np.array([left, right, right, left, left]), np.array([bottom, bottom, top, top, bottom])


def state_marks(
    curriculum: RunCurriculum,
    teacher: str,
    step: int,
    view: TaskView,
    scores: base.ColourScale | None,
    most: int | None,
) -> list[base.Mark]:
    """Return the marks of a teacher's boxes, Gaussians and at most `most` probed tasks at a step.

    `scores` is the colour scale of the boxes. Marks are empty without probes.
    """
    tasks, update = curriculum.probed_at(step)[:most], curriculum.update_at(step)
    update = update if len(tasks) else None
    boxes, gaussians = ([], []) if update is None else (boxes_of(update), gaussians_of(update))
    style: dict[str, Any] = {"look": teacher_style(teacher), "teacher": teacher}
    xs, ys = view.dots(np.asarray(tasks, np.float64))
    return [
        base.Polygons(outlines=view.boxes(boxes), colours=scores, width=1.2, opacity=0.08, **style),
        base.Polygons(outlines=view.gaussians(gaussians), **style),
        base.Scatter(
            x=xs, y=ys, look=base.PLAIN, teacher=teacher, opacity=0.75, edge="white", hover=view.hover
        ),
    ]


def probed_tasks(
    curricula: Mapping[str, RunCurriculum], axes: Sequence[Axis], name: str, caption: str
) -> base.Chart | None:
    """Return a chart of probed tasks, animated over steps with a panel per teacher; None without probes."""
    view, panels = TaskView(axes), []
    for teacher, label in short_labels(curricula, base.LONGEST_NAME).items():
        steps = sorted({int(step) for step in curricula[teacher].probes["step"]})
        chosen = [steps[index] for index in base.spaced_indices(len(steps), MOMENTS)]
        if chosen and view.varied:
            marks = {
                step: state_marks(curricula[teacher], teacher, step, view, None, DOTS) for step in chosen
            }
            panels.append(_animated(marks, view, label, teacher))
    return _grid(panels, name, "Probed tasks", caption)


def _animated(marks: Mapping[int, list[base.Mark]], view: TaskView, name: str, teacher: str) -> base.Panel:
    """Return a panel of a teacher's marks animated over steps, initially showing the last step."""

    def at(step: int) -> base.Panel:
        return base.Panel(*view.scales(), marks[step], name, teacher=teacher)

    return base.animated(at, list(marks), list(marks)[-1])


def _grid(panels: Sequence[base.Panel], name: str, heading: str, caption: str) -> base.Chart | None:
    rows = base.grid(panels, 4)
    size = base.PAGE_WIDTH, 0.5 + 2.2 * len(rows)
    return base.Chart(name, rows, heading, caption, size=size, pixels=290) if panels else None


def training_tasks(
    curricula: Mapping[str, RunCurriculum], axes: Sequence[Axis], name: str, caption: str
) -> base.Chart | None:
    """Return a chart of training tasks coloured by return, animated over steps; None without episodes."""
    view, panels = TaskView(axes), []
    shown = {teacher: curriculum for teacher, curriculum in curricula.items() if len(curriculum.episodes)}
    if not shown or not view.varied:
        return None
    colours = return_colours(shown)
    for teacher, label in short_labels(shown, base.LONGEST_NAME).items():
        marks: dict[int, list[base.Mark]] = {}
        for number in range(PANELS):
            part, end = shown[teacher].during(number), round(shown[teacher].steps * (number + 1) / PANELS)
            if len(part.episodes):
                marks[end] = [episode_marks(part, teacher, view, colours, PAGE_EPISODES)]
        if marks:
            panels.append(_animated(marks, view, label, teacher))
    return _grid(panels, name, "Training tasks", caption)


def return_colours(curricula: Mapping[str, RunCurriculum]) -> base.ColourScale:
    """Return the colour scale of returns over all runs, with the mastery threshold marked."""
    mastery = next(iter(curricula.values())).mastery
    low, high = return_range(curricula, mastery)
    return base.ColourScale(RETURN_COLOURS, low, high, "Return of the episode", open=True, mark=mastery)


def episode_marks(
    part: RunCurriculum, teacher: str, view: TaskView, colours: base.ColourScale, most: int
) -> base.Scatter:
    """Return the marks of up to `most` training tasks, evenly spaced over `part` and coloured by return."""
    chosen = base.spaced_indices(len(part.episodes), most)
    xs, ys = view.dots(part.tasks[chosen].astype(np.float64) if chosen else np.empty((0, 0)))
    returns = part.episodes["episodic_return"].to_numpy(np.float64)[chosen].round(1)
    return base.Scatter(
        x=xs,
        y=ys,
        values=np.repeat(returns, 1 if view.plane else len(view.varied)),
        colours=colours,
        teacher=teacher,
        size=6.0,
        edge=INK,
        hover=f"{view.hover}<br>return {{value}}",
    )


def projected(curriculum: RunCurriculum, dimensions: tuple[int, int]) -> RunCurriculum:
    """Return the projection of a curriculum onto two task dimensions, with Gaussians marginalised.

    Args:
        curriculum: curriculum of any number of dimensions.
        dimensions: indices of the horizontal and the vertical dimension.

    Raises:
        ValueError: if the tasks have no such dimension, or both are the same.
    """
    chosen = list(dimensions)
    tasks = [task for table in (curriculum.episodes, curriculum.probes) for task in table["task"].head(1)]
    size = min(map(len, tasks), default=max(chosen) + 1)
    if len(set(chosen)) < 2 or not all(0 <= dimension < size for dimension in chosen):
        raise ValueError(f"dimensions {chosen}: expected two different ones from 0 to {size - 1}")

    def part(task: Any) -> Any:
        return None if task is None else np.asarray(task)[chosen]

    def marginal(gaussian: Mapping[str, Any]) -> dict[str, Any]:
        covariance = np.array([list(row) for row in gaussian["covariance"]], dtype=np.float64)
        mean = np.asarray(gaussian["mean"], dtype=np.float64)[chosen]
        return {**gaussian, "mean": mean, "covariance": covariance[np.ix_(chosen, chosen)]}

    def side(box: Mapping[str, Any]) -> dict[str, Any]:
        ends = {name: np.asarray(box[name], dtype=np.float64)[chosen] for name in ("low", "high")}
        return {**box, **ends, "above": float(box["score"])}

    episodes, probes, updates = curriculum.episodes, curriculum.probes, curriculum.updates
    world = pd.Series([part(task) for task in episodes["world_task"]], index=episodes.index, dtype=object)
    columns = {
        name: pd.Series(
            [[project(shape) for shape in (() if shapes is None else shapes)] for shapes in updates[name]],
            index=updates.index,
            dtype=object,
        )
        for name, project in (("gaussians", marginal), ("boxes", side))
    }
    return replace(
        curriculum,
        episodes=episodes.assign(task=episodes["task"].map(part), world_task=world),
        probes=probes.assign(task=probes["task"].map(part)),
        updates=updates.assign(**columns),
    )
