"""Strips of training tasks: episodes coloured by return, part by part of a run."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from analysis.data.curricula import PANELS, Curriculum, return_range
from analysis.data.task_axes import Axis
from analysis.figures.elements.task_planes import frame, label_plane, remark
from analysis.figures.style import styled
from analysis.looks import INK, RETURN_COLOURS
from analysis.names import short_labels, teacher_order

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
