"""Film strips of the task distribution: probed tasks, Gaussians and boxes at moments of a run."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, Rectangle
from numpy.typing import NDArray

from analysis.data.curricula import Curriculum, boxes_of, gaussians_of, moments
from analysis.data.task_axes import Axis
from analysis.figures.elements.task_planes import frame, label_plane, remark
from analysis.figures.style import TWO_COLUMNS, styled
from analysis.formatting import amount
from analysis.looks import INK, look

REPORT_WIDTH = 10.2
"""Of a figure over the full width of a page on the screen, inches."""

SMALL = 1 / 3
"""Share of both dimensions under which tasks of a run are drawn at their own scale."""

SCORE_COLOURS = "YlGnBu"
"""From pale for no score to dark for the highest; readable with any colour vision."""


class Shot(NamedTuple):
    """One row of a film strip: a run, under the name of its teacher or of its seed."""

    name: str
    teacher: str
    curriculum: Curriculum


@styled
def film_strip(
    shots: Sequence[Shot],
    plane: tuple[Axis, Axis],
    steps: Sequence[int] | None = None,
    width: float = TWO_COLUMNS,
) -> Figure:
    """Draws probed tasks, Gaussians and boxes: a row per run, a column per moment.

    Gaussians are drawn at two standard deviations, fuller for more weight; a single box as an outline;
    several boxes as regions coloured by score, with a scale for each row. A row whose tasks lie in a small
    part of the plane shows that part, in a frame of the teacher's colour.

    Args:
        shots: runs of several teachers, or of several seeds of one; of two task dimensions, else first
            `analysis.figures.curricula.motion.projected`.
        plane: the two task dimensions.
        steps: the moments; `MOMENTS` of them over the run if None.
        width: of the figure, inches.

    Raises:
        ValueError: no runs, no probes, or tasks that are not two-dimensional.
    """
    steps = checked_steps(shots, steps)
    small: Any = {"font.size": 6.5, "axes.titlesize": 7, "axes.labelsize": 7} if width < REPORT_WIDTH else {}
    with mpl.rc_context(small):
        side = 1.6 * width / REPORT_WIDTH
        figure = Figure(figsize=(width, 0.9 + side * len(shots)), layout="constrained")
        grid = figure.subplots(len(shots), len(steps), sharex="row", sharey="row", squeeze=False)
        label_plane(figure, grid[0, 0], plane)
        whole = []
        for row, shot in zip(grid, shots, strict=True):
            scores = score_scale(shot.curriculum, steps)
            for step, axes in zip(steps, row, strict=True):
                draw_state(axes, shot, step, scores)
            row[0].set_ylabel(shot.name, fontweight="bold")
            whole += [] if to_scale(row, shot, plane, steps) else [row]
            if scores is not None:
                bar = figure.colorbar(scores, ax=row.tolist(), fraction=0.02, pad=0.01, aspect=14)
                bar.set_label("Score of a region")
                bar.outline.set_visible(False)
        for step, axes in zip(steps, grid[0], strict=True):
            axes.set_title(moment_name(step), fontweight="normal")
        for axes in itertools.chain.from_iterable(whole[:-1]):
            axes.tick_params(labelbottom=False)  # those of the last row are the same
    return figure


def to_scale(panels: Iterable[Axes], shot: Shot, plane: tuple[Axis, Axis], steps: Sequence[int]) -> bool:
    """Gives the panels of a run the bounds of the plane, or of its tasks where these fill little of it.

    Args:
        panels: drawn by `draw_state`.
        shot: the run.
        plane: the two task dimensions.
        steps: the moments.

    Returns:
        True if the scale is its own.
    """
    tasks = np.concatenate([shot.curriculum.probed_at(step).reshape(-1, 2) for step in steps])
    low, high = np.array([[axis.low, axis.high] for axis in plane]).T
    least, most = (tasks.min(axis=0), tasks.max(axis=0)) if len(tasks) else (low, high)
    own = bool((most - least < SMALL * (high - low)).all())
    if own:
        margin = np.maximum(0.1 * (most - least), 0.01 * (high - low))
        low, high = np.maximum(least - margin, low), np.minimum(most + margin, high)
    for axes in panels:
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        if own:
            axes.spines[:].set_color(look(shot.teacher).colour)
    return own


def checked_steps(shots: Sequence[Shot], steps: Sequence[int] | None) -> list[int]:
    """Returns the moments to draw, `MOMENTS` over the runs if none are given.

    Raises:
        ValueError: no runs, no probes, or tasks that are not two-dimensional.
    """
    if not shots:
        raise ValueError("no runs: expected at least one, to draw its curriculum")
    for shot in shots:
        tasks = shot.curriculum.probes["task"]
        if len(tasks) and len(tasks.iloc[0]) != 2:
            raise ValueError(
                f"tasks of {shot.name} have {len(tasks.iloc[0])} dimensions: expected 2; choose two with "
                f"analysis.figures.curricula.motion.projected"
            )
    found = moments({str(i): shot.curriculum for i, shot in enumerate(shots)}) if steps is None else steps
    if not len(found):
        raise ValueError("no moments: expected runs whose teachers were probed, or steps")
    return list(found)


def moment_name(step: int) -> str:
    """Returns how a moment is headed: ``4 million steps``."""
    return f"{amount(step)} steps" if step else "start"


def score_scale(curriculum: Curriculum, steps: Sequence[int]) -> ScalarMappable | None:
    """Returns the colours of a teacher's regions over all moments; None if it has at most one at a time."""
    updates = [curriculum.update_at(step) for step in steps]
    boxes = [boxes_of(update) for update in updates if update is not None]
    scores = [box["score"] for each in boxes if len(each) > 1 for box in each]
    return ScalarMappable(Normalize(min(0.0, *scores), max(scores)), SCORE_COLOURS) if scores else None


def draw_state(axes: Axes, shot: Shot, step: int, scores: ScalarMappable | None) -> None:
    """Draws what a teacher had come to at `step`: its boxes, its Gaussians, and its probed tasks."""
    frame(axes)
    curriculum, colour = shot.curriculum, look(shot.teacher).colour
    probes = curriculum.probed_at(step)
    if not len(probes):
        remark(axes, "not reached")
        return
    update = curriculum.update_at(step)
    if update is not None:
        _draw_boxes(axes, boxes_of(update), colour, scores)
        _draw_gaussians(axes, gaussians_of(update), colour)
    axes.scatter(
        probes[:, 0],
        probes[:, 1],
        s=8,
        color=INK,
        alpha=0.8,
        linewidth=0.35,
        edgecolor="white",
        clip_on=False,
    )


def _draw_boxes(
    axes: Axes, boxes: Sequence[Mapping[str, Any]], colour: str, scores: ScalarMappable | None
) -> None:
    for box in boxes:
        (x, y), (right, top) = box["low"], box["high"]
        if len(boxes) > 1 and scores is not None:
            style: dict[str, Any] = {"facecolor": scores.to_rgba(box["score"]), "edgecolor": "white"}
            style["linewidth"] = 0.5
        else:
            style = {"facecolor": (colour, 0.15), "edgecolor": colour, "linewidth": 1.4}
        axes.add_patch(Rectangle((x, y), right - x, top - y, **style))


def _draw_gaussians(axes: Axes, gaussians: Sequence[Mapping[str, Any]], colour: str) -> None:
    heaviest = max((float(gaussian["weight"]) for gaussian in gaussians), default=1.0)
    for gaussian in gaussians:
        covariance = np.array([list(row) for row in gaussian["covariance"]], dtype=np.float64)
        share = float(gaussian["weight"]) / heaviest if heaviest > 0 else 1.0
        axes.add_patch(ellipse(np.asarray(gaussian["mean"], dtype=np.float64), covariance, share, colour))


def ellipse(
    mean: NDArray[np.float64], covariance: NDArray[np.float64], share: float, colour: str = INK
) -> Ellipse:
    """Returns a two-dimensional Gaussian at two standard deviations.

    Args:
        mean: (2,).
        covariance: (2, 2).
        share: its weight over the heaviest one's, in [0, 1]; fills and outlines it.
        colour: of both.
    """
    values, vectors = np.linalg.eigh(covariance)
    angle = float(np.degrees(np.arctan2(vectors[1, -1], vectors[0, -1])))
    minor, major = 4.0 * np.sqrt(np.maximum(values, 0.0))
    return Ellipse(
        tuple(mean),
        float(major),
        float(minor),
        angle=angle,
        facecolor=(colour, 0.04 + 0.18 * share),
        edgecolor=(colour, 0.35 + 0.65 * share),
        linewidth=0.6 + 0.8 * share,
    )
