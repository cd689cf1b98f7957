"""Charts of curricula: film strips, animations, training tasks, task dimensions, logged scalars.

Common arguments: `curricula` has one run per teacher, and `plane` the two task dimensions.
"""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

import numpy as np
import pandas as pd

from analysis.charts import base
from analysis.charts.tasks import (
    PAPER_EPISODES,
    TaskView,
    episode_marks,
    return_colours,
    state_marks,
    task_axis,
)
from analysis.data.curricula import PANELS, Axis, RunCurriculum, boxes_of, gaussians_of, moments
from analysis.formatting import steps_text
from analysis.names import short_labels
from analysis.teacher_styles import TeacherStyle, teacher_style

SMALL = 1 / 3  # zoom in on tasks that span less than this share of each dimension

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
"""Quantiles of probed tasks in bands: outer band, inner band, median."""

UPDATES = 24  # maximum number of teacher updates drawn, evenly spaced over a run

MOST_FRAMES, MOST_SHOTS = 60, 12
"""Largest numbers of frames and panels of an animation, so that its file stays under a few megabytes."""

Run = TypeVar("Run")


class Shot(NamedTuple):
    """Run shown as a row of a film strip, named by its teacher or its seed."""

    name: str
    teacher: str
    curriculum: RunCurriculum


def film_strip(
    shots: Sequence[Shot],
    plane: tuple[Axis, Axis],
    steps: Sequence[int] | None = None,
    width: float = base.TWO_COLUMNS,
) -> base.Chart:
    """Return a chart of probed tasks, Gaussians and boxes, with a row per run and a column per step.

    Gaussians are drawn at two standard deviations, more opaque for more weight; a single box as an outline;
    several boxes coloured by score, with a scale per row. A row whose tasks lie in a small part of the plane
    shows that part, in a frame of the teacher's colour.

    Args:
        shots: runs of several teachers, or of several seeds of one, with two task dimensions (see
            `analysis.charts.tasks.projected`).
        plane: two task dimensions.
        steps: steps to draw; by default `data.curricula.moments` of the runs.
        width: width of the figure, in inches.

    Raises:
        ValueError: if runs or probes are missing, or tasks are not two-dimensional.
    """
    steps = _checked(shots, steps)
    rows: list[list[base.Panel]] = []
    for shot in shots:
        panel, row = _animated(shot, plane, steps), []
        for step in steps:
            name = f"{steps_text(step)} steps" if step else "start"
            row.append(replace(panel.at(step), title="" if rows else name, side=shot.name))
        rows.append(row)
    side = 1.6 * width / base.PAGE_WIDTH
    size, letters = (width, 0.9 + side * len(rows)), 8.5 if width >= base.PAGE_WIDTH else 6.5
    return base.Chart("film", rows, legend=base.Legend.NONE, size=size, letters=letters)


def sheets(runs: Sequence[Run]) -> list[Sequence[Run]]:
    """Split runs into the fewest parts of similar size that have at most `MOST_SHOTS` runs each."""
    count = math.ceil(len(runs) / MOST_SHOTS)
    ends = [round(len(runs) * number / count) for number in range(1, count + 1)]
    return [runs[first:last] for first, last in itertools.pairwise([0, *ends])]


def film(shots: Sequence[Shot], plane: tuple[Axis, Axis], frames: int = 30) -> base.Chart:
    """Return an animated film strip, with a panel per run and a frame per step.

    Args:
        shots: runs as in `film_strip`, at most `MOST_SHOTS`.
        plane: two task dimensions.
        frames: largest number of frames, one per step with probes.

    Raises:
        ValueError: if there are too many frames or runs, or `film_strip` raises it.
    """
    if not 1 <= frames <= MOST_FRAMES:
        raise ValueError(f"{frames} frames: expected 1 to {MOST_FRAMES}, to bound the size of the file")
    if len(shots) > MOST_SHOTS:
        raise ValueError(f"{len(shots)} runs: expected at most {MOST_SHOTS} in one animation")
    _checked(shots, None)
    steps = moments({str(index): shot.curriculum for index, shot in enumerate(shots)}, frames)
    rows = base.grid([_animated(shot, plane, steps) for shot in shots], 4)
    size = 0.5 + 1.9 * max(len(rows[0]), 1.2), 0.75 + 2.0 * len(rows)
    return base.Chart("motion", rows, legend=base.Legend.NONE, size=size)


def _animated(shot: Shot, plane: tuple[Axis, Axis], steps: Sequence[int]) -> base.Panel:
    """Return the animated panel of a run, zoomed in on its tasks if they lie in a small part of the plane."""
    view, updates = TaskView(plane), [shot.curriculum.update_at(step) for step in steps]
    boxes = [boxes_of(update) for update in updates if update is not None]
    scores = [float(box["score"]) for regions in boxes if len(regions) > 1 for box in regions]
    colours = (
        base.ColourScale("YlGnBu", min(0.0, *scores), max(scores), "Score of a region") if scores else None
    )
    tasks = np.concatenate([shot.curriculum.probed_at(step).reshape(-1, 2) for step in steps])
    low, high = np.array([[axis.low, axis.high] for axis in plane]).T
    least, most = (tasks.min(axis=0), tasks.max(axis=0)) if len(tasks) else (low, high)
    zoomed = bool((most - least < SMALL * (high - low)).all())
    if zoomed:
        margin = np.maximum(0.1 * (most - least), 0.01 * (high - low))
        low, high = np.maximum(least - margin, low), np.minimum(most + margin, high)
    x, y = (
        replace(task_axis(axis), low=float(bounds[0]), high=float(bounds[1]))
        for axis, bounds in zip(plane, np.transpose([low, high]), strict=True)
    )
    frame = teacher_style(shot.teacher).colour if zoomed else ""

    def at(step: Any) -> base.Panel:
        marks = state_marks(shot.curriculum, shot.teacher, step, view, colours, None)
        reached = len(shot.curriculum.probed_at(step))
        return base.Panel(x, y, marks, shot.name, frame=frame, empty_text="" if reached else "not reached")

    return base.animated(at, steps, steps[-1])


def _checked(shots: Sequence[Shot], steps: Sequence[int] | None) -> list[int]:
    """Check the runs, and return the steps to draw: `steps`, or by default the `moments` of the runs."""
    if not shots:
        raise ValueError("no runs: expected at least one, to draw its curriculum")
    for shot in shots:
        tasks = shot.curriculum.probes["task"]
        if len(tasks) and len(tasks.iloc[0]) != 2:
            raise ValueError(
                f"tasks of {shot.name} have {len(tasks.iloc[0])} dimensions: expected 2; choose two with "
                f"analysis.figures.projected"
            )
    if steps is None:
        steps = moments({str(index): shot.curriculum for index, shot in enumerate(shots)})
    if not len(steps):
        raise ValueError("no moments: expected runs whose teachers were probed, or steps")
    return list(steps)


def curriculum_strip(curricula: Mapping[str, RunCurriculum], plane: tuple[Axis, Axis]) -> base.Chart:
    """Return a chart of training tasks coloured by return, by teacher (row) and part of the run (column)."""
    view, colours = TaskView(plane), return_colours(curricula)
    rows: list[list[base.Panel]] = []
    for teacher, side in short_labels(curricula, 16).items():
        row = []
        for number in range(PANELS):
            part = curricula[teacher].during(number)
            name = f"{100 * number // PANELS}\N{EN DASH}{100 * (number + 1) // PANELS} %"
            dots = [episode_marks(part, teacher, view, colours, PAPER_EPISODES)]
            remark = "no episodes" if part.episodes.empty else ""
            row.append(base.Panel(*view.scales(), dots, "" if rows else name, side=side, empty_text=remark))
        rows.append(row)
    size = base.PAGE_WIDTH, 0.9 + 1.75 * len(rows)
    return base.Chart("training-tasks", rows, legend=base.Legend.NONE, size=size)


def dimension_bands(curricula: Mapping[str, RunCurriculum], axes: Sequence[Axis]) -> base.Chart:
    """Return a chart of quantiles of probed tasks over steps, by dimension (row) and teacher (column).

    Dark lines are the bounds of a single box, or two standard deviations of a single Gaussian; dots are the
    means of several Gaussians, larger for more weight.

    Args:
        curricula: one run per teacher.
        axes: task dimensions; constant ones are ignored.
    """
    varied = [index for index, axis in enumerate(axes) if axis.high > axis.low]
    names = short_labels(curricula, 14)
    budget = float(max(curriculum.steps for curriculum in curricula.values()))
    x = base.PanelAxis(base.STEPS, base.AxisKind.STEPS, 0.0, budget)
    rows = [
        [
            base.Panel(
                x,
                task_axis(axes[index]),
                [*_bands(curricula[teacher], index, teacher), *_regions(curricula[teacher], index)],
                name if index == varied[0] else "",
            )
            for teacher, name in names.items()
        ]
        for index in varied
    ]
    height = float(np.clip(7.2 / max(len(varied), 1), 0.5, 2.2))
    width = float(np.clip(8.4 / len(names), 1.05, 4.0))
    size = 1.8 + width * len(names), 0.8 + height * len(varied)
    return base.Chart("dimensions", rows, legend=base.Legend.NONE, size=size)


def _bands(curriculum: RunCurriculum, dimension: int, teacher: str) -> Iterator[base.Mark]:
    steps = np.unique(curriculum.probes["step"])
    levels = np.array([np.quantile(curriculum.probed_at(step)[:, dimension], QUANTILES) for step in steps]).T
    style, x = teacher_style(teacher)._replace(marker="", dashes="-"), steps.astype(np.float64)
    yield base.Curve(x=x, low=levels[0], high=levels[4], look=style, opacity=0.18)
    yield base.Curve(x=x, y=levels[2], low=levels[1], high=levels[3], look=style, opacity=0.38, width=1.6)


def _regions(curriculum: RunCurriculum, dimension: int) -> Iterator[base.Mark]:
    updates = curriculum.updates.sort_values("step", kind="stable")
    bounds, means = [], []
    for _, update in updates.iloc[base.spaced_indices(len(updates), UPDATES)].iterrows():
        boxes, gaussians = boxes_of(update), gaussians_of(update)
        if len(boxes) == 1:
            bounds.append((update["step"], boxes[0]["low"][dimension], boxes[0]["high"][dimension]))
        elif len(gaussians) == 1:
            mean, covariance = gaussians[0]["mean"], gaussians[0]["covariance"]
            reach = 2 * np.sqrt(covariance[dimension][dimension])
            bounds.append((update["step"], mean[dimension] - reach, mean[dimension] + reach))
        else:
            total = sum(float(gaussian["weight"]) for gaussian in gaussians) or 1.0
            means += [(update["step"], g["mean"][dimension], g["weight"] / total) for g in gaussians]
    if bounds:
        steps, *ends = np.array(bounds, dtype=np.float64).T
        for end in ends:
            yield base.Curve(x=steps, y=end, look=TeacherStyle(base.PLAIN.colour, "", "-"), width=1.2)
    if means:
        steps, values, shares = np.array(means, dtype=np.float64).T
        yield base.Scatter(x=steps, y=values, size=1.8 * np.sqrt(1 + 8 * shares), opacity=0.55)


MOST_PER_TEACHER = 8  # maximum number of scalars drawn per teacher
BINS = 150  # series with more points are drawn as the median and range of this many bins


def scalars_of(curriculum: RunCurriculum) -> dict[str, pd.Series]:
    """Return the finite values of a teacher's logged scalars by name, indexed by step."""
    rows = [
        (int(step), str(name), float(value))
        for step, scalars in zip(curriculum.updates["step"], curriculum.updates["scalars"], strict=True)
        for name, value in (scalars or ())
        if math.isfinite(value)
    ]
    table = pd.DataFrame(rows, columns=["step", "name", "value"])
    return {str(name): rows.set_index("step")["value"] for name, rows in table.groupby("name")}


def scalar_chart(curricula: Mapping[str, RunCurriculum], name: str, caption: str) -> base.Chart | None:
    """Return a chart with a panel per scalar, at most `MOST_PER_TEACHER` per teacher."""
    panels = []
    for teacher, label in short_labels(curricula, base.LONGEST_NAME).items():
        for scalar, values in list(scalars_of(curricula[teacher]).items())[:MOST_PER_TEACHER]:
            whole = bool(values.max() - values.min() < 5 and (values % 1 == 0).all())
            axes = (base.PanelAxis(base.STEPS, base.AxisKind.STEPS), base.PanelAxis(whole=whole, grid=True))
            heading = label, scalar.replace("_", " ")
            panels.append(base.Panel(*axes, [_series(teacher, values)], *heading, teacher=teacher))
    rows = base.grid(panels, 4)
    size = 10.2, 0.4 + 1.8 * len(rows)
    return base.Chart(name, rows, "Teachers' logs", caption, size=size, pixels=230) if panels else None


def hidden_scalars(curricula: Mapping[str, RunCurriculum]) -> int:
    """Return the number of scalars that `scalar_chart` leaves out."""
    counts = (len(scalars_of(curriculum)) for curriculum in curricula.values())
    return sum(max(0, count - MOST_PER_TEACHER) for count in counts)


def _series(teacher: str, values: pd.Series) -> base.Curve:
    line, hover = teacher_style(teacher)._replace(marker="", dashes="-"), "{y:.4g} at step {x:,d}"
    style: dict[str, Any] = {"look": line, "teacher": teacher, "width": 1.5, "hover": hover}
    if len(values) <= BINS:
        return base.Curve(x=values.index.to_numpy(np.float64), y=values.to_numpy(np.float64), **style)
    part = np.arange(len(values)) * BINS // len(values)
    binned = pd.DataFrame({"step": values.index, "value": values.to_numpy()}).groupby(part)
    low, median, high = (binned["value"].agg(name).to_numpy(np.float64) for name in ("min", "median", "max"))
    steps = binned["step"].median().to_numpy(np.float64)
    return base.Curve(x=steps, y=median, low=low, high=high, opacity=0.2, **style)
