"""Curricula: film strips, animations, bands by dimension and strips of training tasks."""

from __future__ import annotations

import io
import itertools
import math
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, Rectangle
from numpy.typing import NDArray
from PIL import Image

from analysis.comparisons.measured import Measured, in_whose_space, which_runs
from analysis.data.curricula import (
    PANELS,
    Axis,
    Curriculum,
    boxes_of,
    gaussians_of,
    moments,
    return_range,
    task_axes,
)
from analysis.figures.elements import frame, label_plane, remark, share_step_label, step_axis
from analysis.figures.style import TWO_COLUMNS, Picture, styled
from analysis.formatting import amount
from analysis.looks import INK, RETURN_COLOURS, look
from analysis.names import short_labels, teacher_order

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
            `analysis.figures.curricula.projected`.
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
                f"analysis.figures.curricula.projected"
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


FRAMES = 30
"""Of an animation, evenly spaced over the runs."""

MOST_FRAMES, MOST_SHOTS = 60, 12
"""An animation has at most so many frames and panels, and so stays under a few megabytes."""

MOVING_DPI = 90
"""Resolution of an animation, in dots per inch."""

COLOURS = 128
"""Colours of all frames of an animation together."""


def projected(curriculum: Curriculum, dimensions: tuple[int, int]) -> Curriculum:
    """Returns a curriculum as it looks along two of its task dimensions.

    Tasks and boxes are projected; of Gaussians the marginals are taken. Where boxes lie behind each
    other, that with the highest score is seen.

    Args:
        curriculum: of any number of dimensions.
        dimensions: the one to the right and the one up, from 0.

    Raises:
        ValueError: the tasks have no such dimension, or both are the same.
    """
    chosen = list(dimensions)
    tasks = [task for table in (curriculum.episodes, curriculum.probes) for task in table["task"].head(1)]
    size = min(map(len, tasks), default=max(chosen) + 1)
    if len(set(chosen)) < 2 or not all(0 <= dimension < size for dimension in chosen):
        raise ValueError(f"dimensions {chosen}: expected two different ones from 0 to {size - 1}")

    def part(task: Any) -> Any:
        return None if task is None else np.asarray(task)[chosen]

    episodes, probes, updates = curriculum.episodes, curriculum.probes, curriculum.updates
    world = [part(task) for task in episodes["world_task"]]
    shown = {
        "task": episodes["task"].map(part),
        "world_task": pd.Series(world, index=episodes.index, dtype=object),
    }
    shapes = {
        "gaussians": [[_marginal(each, chosen) for each in _some(found)] for found in updates["gaussians"]],
        "boxes": [[_side(each, chosen) for each in _some(found)] for found in updates["boxes"]],
    }
    columns = {name: pd.Series(found, index=updates.index, dtype=object) for name, found in shapes.items()}
    return replace(
        curriculum,
        episodes=episodes.assign(**shown),
        probes=probes.assign(task=probes["task"].map(part)),
        updates=updates.assign(**columns),
    )


@styled
def animation(
    shots: Sequence[Shot], plane: tuple[Axis, Axis], frames: int = FRAMES, seconds: float = 6.0
) -> bytes:
    """Returns a film strip in motion, as a GIF that repeats: a panel per run, drawn as in `film_strip`.

    Args:
        shots: as of `film_strip`; at most `MOST_SHOTS`.
        plane: the two task dimensions.
        frames: at most so many, and at most one for each step at which a teacher was probed.
        seconds: length of the whole; the last frame stays for another second.

    Raises:
        ValueError: too many frames or runs, or what `film_strip` raises.
    """
    if not 1 <= frames <= MOST_FRAMES:
        raise ValueError(f"{frames} frames: expected 1 to {MOST_FRAMES}, to bound the size of the file")
    if len(shots) > MOST_SHOTS:
        raise ValueError(f"{len(shots)} runs: expected at most {MOST_SHOTS} in one animation")
    checked_steps(shots, None)
    steps = moments({str(place): shot.curriculum for place, shot in enumerate(shots)}, frames)
    images = list(_images(shots, plane, steps))
    palette = _palette(images)
    pictures = [_quantized(image, palette) for image in images]
    # GIF counts hundredths of a second, and viewers slow down what is faster than two of them.
    pause = max(20, round(1000 * seconds / len(pictures) / 10) * 10)
    buffer = io.BytesIO()
    pictures[0].save(
        buffer,
        format="GIF",
        save_all=True,
        append_images=pictures[1:],
        duration=[*[pause] * (len(pictures) - 1), pause + 1000],
        loop=0,
        optimize=False,
    )
    return buffer.getvalue()


def _images(shots: Sequence[Shot], plane: tuple[Axis, Axis], steps: Sequence[int]) -> Iterator[Image.Image]:
    columns = min(len(shots), 4)
    lines = math.ceil(len(shots) / columns)
    figure = Figure(
        figsize=(0.5 + 1.9 * max(columns, 1.2), 0.75 + 2.0 * lines), layout="constrained", dpi=MOVING_DPI
    )
    canvas = FigureCanvasAgg(figure)
    grid: list[Axes] = figure.subplots(lines, columns, squeeze=False).ravel().tolist()
    for spare in grid[len(shots) :]:
        spare.remove()
    label_plane(figure, grid[0], plane)
    scales = [score_scale(shot.curriculum, steps) for shot in shots]
    for step in steps:
        for axes, shot, scores in zip(grid, shots, scales, strict=False):
            for artist in (*axes.collections, *axes.patches, *axes.texts):
                artist.remove()
            draw_state(axes, shot, step, scores)
            to_scale([axes], shot, plane, steps)
            axes.set_title(shot.name)
        figure.suptitle(moment_name(step), fontsize=9)
        canvas.draw()  # type: ignore[no-untyped-call]
        figure.set_layout_engine("none")  # panels stay where the first frame has them
        pixels = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
        yield Image.fromarray(pixels[..., :3])


def _palette(images: Sequence[Image.Image]) -> Image.Image:
    """Returns the colours that all frames share, so that what does not move does not flicker."""
    few = [images[index] for index in np.unique(np.linspace(0, len(images) - 1, 5).round().astype(int))]
    width, height = few[0].size
    sheet = Image.new("RGB", (width, height * len(few)))
    for place, image in enumerate(few):
        sheet.paste(image, (0, place * height))
    colours = sheet.quantize(COLOURS - 1, dither=Image.Dither.NONE).getpalette() or []
    palette = Image.new("P", (1, 1))
    palette.putpalette([255, 255, 255, *colours[: 3 * (COLOURS - 1)]])
    return palette


def _quantized(image: Image.Image, palette: Image.Image) -> Image.Image:
    """Returns `image` in the colours of `palette`, with paper exactly white: Pillow only comes near."""
    found = image.quantize(palette=palette, dither=Image.Dither.NONE)
    places = np.array(found)
    places[(np.asarray(image) == 255).all(axis=2)] = 0
    exact = Image.fromarray(places, "P")
    exact.putpalette(found.getpalette() or [])
    return exact


def _some(found: Any) -> Any:
    return () if found is None else found


def _marginal(gaussian: dict[str, Any], chosen: list[int]) -> dict[str, Any]:
    covariance = np.array([list(row) for row in gaussian["covariance"]], dtype=np.float64)
    mean = np.asarray(gaussian["mean"], dtype=np.float64)[chosen]
    return {**gaussian, "mean": mean, "covariance": covariance[np.ix_(chosen, chosen)]}


def _side(box: dict[str, Any], chosen: list[int]) -> dict[str, Any]:
    ends = {name: np.asarray(box[name], dtype=np.float64)[chosen] for name in ("low", "high")}
    return {**box, **ends, "above": float(box["score"])}


QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
"""Of the probed tasks: outer band, inner band, median."""

SHAPES = 24
"""At most this many updates are drawn, evenly spaced over the run's."""


@styled
def dimension_bands(curricula: Mapping[str, Curriculum], axes: Sequence[Axis]) -> Figure:
    """Draws quantiles of probed tasks against steps: a row per dimension, a column per teacher.

    Dark lines are the bounds of a teacher's box if it has a single one, or two standard deviations
    around its Gaussian; dots the means of several Gaussians, larger for more weight.

    Args:
        curricula: one run for each teacher.
        axes: the task dimensions; constant ones are left out.
    """
    teachers = sorted(curricula, key=teacher_order)
    varied = [index for index, axis in enumerate(axes) if axis.high > axis.low]
    height = float(np.clip(7.2 / max(len(varied), 1), 0.5, 2.2))
    width = float(np.clip(8.4 / len(teachers), 1.05, 4.0))
    size = 1.8 + width * len(teachers), 0.8 + height * len(varied)
    figure = Figure(figsize=size, layout="constrained")
    grid = figure.subplots(len(varied), len(teachers), sharex=True, sharey="row", squeeze=False)
    longest = max(curriculum.steps for curriculum in curricula.values())
    for row, index in zip(grid, varied, strict=True):
        for panel, teacher in zip(row, teachers, strict=True):
            frame(panel)
            _bands(panel, curricula[teacher], index, look(teacher).colour)
            _shapes(panel, curricula[teacher], index)
        _name(row[0], axes[index])
    names = short_labels(teachers, 14)
    for panel, teacher in zip(grid[0], teachers, strict=True):
        panel.set_title(names[teacher], fontsize=8 if width < 1.6 else None)
    for panel in grid[-1]:
        step_axis(panel, longest, ticks=4 if width < 1.6 else 6)
    share_step_label(figure, grid)
    figure.align_ylabels(grid[:, 0])
    return figure


def _name(axes: Axes, axis: Axis) -> None:
    margin = 0.04 * (axis.high - axis.low)
    axes.set_ylim(axis.low - margin, axis.high + margin)
    axes.set_yticks([axis.low, axis.high])
    name, bracket, unit = axis.name.partition(" (")
    lines = [*textwrap.wrap(name, 22), *([bracket.strip() + unit] if bracket else [])]
    axes.set_ylabel(
        "\n".join(lines) if len(axis.name) > 22 else axis.name,
        rotation=0,
        ha="right",
        va="center",
        labelpad=2,
    )


def _bands(axes: Axes, curriculum: Curriculum, dimension: int, colour: str) -> None:
    steps = np.unique(curriculum.probes["step"])
    levels = np.array([np.quantile(curriculum.probed_at(step)[:, dimension], QUANTILES) for step in steps]).T
    axes.fill_between(steps, levels[0], levels[4], color=colour, alpha=0.18, linewidth=0)
    axes.fill_between(steps, levels[1], levels[3], color=colour, alpha=0.38, linewidth=0)
    axes.plot(steps, levels[2], color=colour, linewidth=1.2)


def _shapes(axes: Axes, curriculum: Curriculum, dimension: int) -> None:
    updates = curriculum.updates.sort_values("step", kind="stable")
    chosen = np.unique(np.linspace(0, len(updates) - 1, min(SHAPES, len(updates))).round().astype(int))
    bounds, means = [], []
    for _, update in updates.iloc[chosen].iterrows():
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
        steps, low, high = np.array(bounds, dtype=np.float64).T
        axes.plot(steps, low, steps, high, color=INK, linewidth=0.9)
    if means:
        steps, values, shares = np.array(means, dtype=np.float64).T
        axes.scatter(steps, values, s=1 + 8 * shares, color=INK, alpha=0.55, linewidth=0)


POINTS = 300
"""At most this many episodes are drawn in a panel, evenly spaced in time."""


@styled
def curriculum_strip(curricula: Mapping[str, Curriculum], plane: tuple[Axis, Axis]) -> Figure:
    """Draws training episodes, coloured by return: a row per teacher, a column per part of the run.

    Args:
        curricula: one run for each teacher.
        plane: the two task dimensions.
    """
    teachers = sorted(curricula, key=teacher_order)
    figure = Figure(figsize=(10.2, 0.9 + 1.75 * len(teachers)), layout="constrained")
    grid = figure.subplots(len(teachers), PANELS, sharex=True, sharey=True, squeeze=False)
    mastery = curricula[teachers[0]].mastery
    colours = ScalarMappable(Normalize(*return_range(curricula, mastery)), RETURN_COLOURS)
    names = short_labels(teachers, 16)
    for row, teacher in zip(grid, teachers, strict=True):
        for part, axes in enumerate(row):
            _panel(axes, curricula[teacher].during(part), colours)
        row[0].set_ylabel(names[teacher], fontweight="bold")
    for part, axes in enumerate(grid[0]):
        axes.set_title(
            f"{100 * part // PANELS}\N{EN DASH}{100 * (part + 1) // PANELS} %", fontweight="normal"
        )
    label_plane(figure, grid[0, 0], plane)
    bar = figure.colorbar(
        colours, ax=grid.ravel().tolist(), extend="both", fraction=0.03, pad=0.01, aspect=25
    )
    bar.set_label("Return of the episode")
    bar.outline.set_visible(False)
    bar.ax.axhline(mastery, color="white", linewidth=1.2)
    return figure


def _panel(axes: Axes, part: Curriculum, colours: ScalarMappable) -> None:
    frame(axes)
    if part.episodes.empty:
        remark(axes, "no episodes")
        return
    chosen = np.unique(np.linspace(0, len(part.episodes) - 1, POINTS).round().astype(int))
    tasks = part.tasks[chosen]
    returns = part.episodes["episodic_return"].to_numpy(float)[chosen]
    axes.scatter(tasks[:, 0], tasks[:, 1], c=colours.to_rgba(returns), s=10, linewidth=0.25, edgecolor=INK)


LARGEST = 20
"""Spaces with more varied dimensions are not drawn."""


def curriculum_pictures(mine: Measured, curricula: Mapping[str, Curriculum]) -> Iterator[Picture]:
    """Yields the figures of `curricula_of` over the whole run, dimension by dimension."""
    if not curricula:
        return
    axes = task_axes(mine.cells)
    varied = sum(axis.low < axis.high for axis in axes)
    probed = {teacher: each for teacher, each in curricula.items() if len(each.probes)}
    whole_plane = len(axes) == varied == 2  # which charts show step by step
    if 0 < varied <= LARGEST and not whole_plane and len(moments(probed)) > 1:
        yield _dimensions(probed, axes, which_runs(curricula))


def _dimensions(curricula: Mapping[str, Curriculum], axes: tuple[Axis, ...], which: str) -> Picture:
    caption = (
        f"{which}. Of the tasks probed without exploration: median, middle half and middle 90 %, "
        f"dimension by dimension. Dark lines: bounds of the teacher's box, or two standard deviations "
        f"around its Gaussian; dots: means of several Gaussians, larger for more weight."
    )
    constant = sum(axis.low == axis.high for axis in axes)
    if constant:
        caption += f" {constant} constant dimension{'s are' if constant > 1 else ' is'} left out."
    return Picture.of(
        "curriculum-dimensions",
        dimension_bands(curricula, axes),
        "Curriculum over training, dimension by dimension",
        caption + in_whose_space(curricula),
    )
