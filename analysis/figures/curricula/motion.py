"""Curricula in motion, and projections of those with more than two task dimensions."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from analysis.data.curricula import Curriculum, moments
from analysis.data.task_axes import Axis
from analysis.figures.curricula.film_strips import (
    Shot,
    checked_steps,
    draw_state,
    moment_name,
    score_scale,
    to_scale,
)
from analysis.figures.elements.task_planes import label_plane
from analysis.figures.style import styled

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
