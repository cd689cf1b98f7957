"""The curriculum of one run on the task plane over time, as a strip of panels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, Rectangle
from numpy.typing import NDArray

from analysis.figures import Axis
from analysis.style import INK, MUTED, short_label, styled, teacher_order
from tma_ray.tasks import MASTERY_RETURN

PANELS = 5
"""Equal parts of a run, one panel each."""

POINTS = 300
"""At most this many episodes are drawn in a panel, evenly spaced in time."""

RETURN_COLOURS = "viridis"
"""Perceptually uniform and readable with any colour vision."""

RETURNS = (-100.0, 300.0)
"""Range of the colours, the same in every report, from falling at once to crossing the track."""


@dataclass(frozen=True, eq=False)
class Curriculum:
    """What one run has to show of its curriculum.

    Attributes:
        episodes: step, task, world_task and episodic_return.
        probes: step and task.
        updates: step, gaussians and boxes of the teacher.
        steps: length of the run.
    """

    episodes: pd.DataFrame
    probes: pd.DataFrame
    updates: pd.DataFrame
    steps: int

    @property
    def shuffled(self) -> bool:
        """Whether the teacher chooses in a shuffled space, where its own shapes mean nothing here."""
        return bool(self.episodes["world_task"].notna().any())

    @property
    def tasks(self) -> NDArray[np.float32]:
        """Tasks of the episodes as the world had them (n, d)."""
        column = self.episodes["world_task" if self.shuffled else "task"]
        return stack(column)

    def during(self, part: int) -> Curriculum:
        """Returns what happened in one of the `PANELS` equal parts of the run."""
        low, high = self.steps * part / PANELS, self.steps * (part + 1) / PANELS

        def cut(frame: pd.DataFrame) -> pd.DataFrame:
            return frame[(frame["step"] > low) & (frame["step"] <= high)]

        return Curriculum(cut(self.episodes), cut(self.probes), cut(self.updates), self.steps)


def stack(tasks: pd.Series) -> NDArray[np.float32]:
    """Returns a column of tasks as one array (n, d); (0, 0) when there are none."""
    return np.stack(tasks.to_list()).astype(np.float32) if len(tasks) else np.empty((0, 0), np.float32)


@styled
def curriculum_strip(curricula: dict[str, Curriculum], plane: tuple[Axis, Axis]) -> Figure:
    """Draws one row per teacher and one column per part of the run.

    Dots are training episodes, coloured by their return; crosses the last tasks probed without
    exploration; outlines the Gaussians (two standard deviations) and boxes the teacher had last.

    Args:
        curricula: one run for each teacher.
        plane: the two task dimensions.
    """
    teachers = sorted(curricula, key=teacher_order)
    figure = Figure(figsize=(10.2, 0.9 + 1.75 * len(teachers)), layout="constrained")
    grid = figure.subplots(len(teachers), PANELS, sharex=True, sharey=True, squeeze=False)
    colours = ScalarMappable(Normalize(*RETURNS), RETURN_COLOURS)
    for row, teacher in zip(grid, teachers, strict=True):
        for part, axes in enumerate(row):
            _panel(axes, curricula[teacher].during(part), colours)
        row[0].set_ylabel(short_label(teacher, 16), fontweight="bold")
    for part, axes in enumerate(grid[0]):
        axes.set_title(
            f"{100 * part // PANELS}\N{EN DASH}{100 * (part + 1) // PANELS} %", fontweight="normal"
        )
    grid[0, 0].set_xlim(plane[0].low, plane[0].high)
    grid[0, 0].set_ylim(plane[1].low, plane[1].high)
    figure.supxlabel(plane[0].name, fontsize=8.5)
    figure.supylabel(plane[1].name, fontsize=8.5)
    bar = figure.colorbar(
        colours, ax=grid.ravel().tolist(), extend="both", fraction=0.03, pad=0.01, aspect=25
    )
    bar.set_label("Return of the episode")
    bar.outline.set_visible(False)
    bar.ax.axhline(MASTERY_RETURN, color="white", linewidth=1.2)
    return figure


def _panel(axes: Axes, part: Curriculum, colours: ScalarMappable) -> None:
    for spine in axes.spines.values():
        spine.set_visible(True)
        spine.set_color("#b9bec6")
    axes.tick_params(length=2)
    chosen = np.unique(np.linspace(0, len(part.episodes) - 1, POINTS).round().astype(int))
    if len(part.episodes):
        tasks = part.tasks[chosen]
        returns = part.episodes["episodic_return"].to_numpy(float)[chosen]
        axes.scatter(
            tasks[:, 0], tasks[:, 1], c=colours.to_rgba(returns), s=10, linewidth=0.25, edgecolor=INK
        )
    elif part.probes.empty:
        axes.text(0.5, 0.5, "no episodes", transform=axes.transAxes, ha="center", va="center", color=MUTED)
    if not part.shuffled:
        _probes(axes, part.probes)
        _shapes(axes, part.updates)


def _probes(axes: Axes, probes: pd.DataFrame) -> None:
    last = stack(probes.loc[probes["step"] == probes["step"].max(), "task"])
    if len(last):
        axes.scatter(last[:, 0], last[:, 1], marker="+", s=9, color="#c8102e", linewidth=0.5, alpha=0.7)


def _shapes(axes: Axes, updates: pd.DataFrame) -> None:
    """Draws the Gaussians and boxes of the last update, if there is one."""
    if updates.empty:
        return
    last = updates.sort_values("step", kind="stable").iloc[-1]
    for gaussian in last["gaussians"] if last["gaussians"] is not None else ():
        covariance = np.array([list(row) for row in gaussian["covariance"]], dtype=np.float64)
        axes.add_patch(ellipse(np.asarray(gaussian["mean"]), covariance, lineweight(gaussian["weight"])))
    for box in last["boxes"] if last["boxes"] is not None else ():
        (x, y), (right, top) = box["low"], box["high"]
        axes.add_patch(Rectangle((x, y), right - x, top - y, fill=False, edgecolor=INK, linewidth=0.6))


def lineweight(weight: float) -> float:
    """Returns the width in points of a Gaussian's outline: heavier components are drawn heavier."""
    return 0.5 + 1.5 * float(weight)


def ellipse(mean: NDArray[np.float64], covariance: NDArray[np.float64], linewidth: float) -> Ellipse:
    """Returns the outline of a two-dimensional Gaussian at two standard deviations."""
    values, vectors = np.linalg.eigh(covariance)
    angle = float(np.degrees(np.arctan2(vectors[1, -1], vectors[0, -1])))
    minor, major = 4.0 * np.sqrt(np.maximum(values, 0.0))
    return Ellipse(
        tuple(mean), float(major), float(minor), angle=angle, fill=False, edgecolor=INK, linewidth=linewidth
    )
