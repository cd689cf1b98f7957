"""The curriculum of one run: what was taught, what its teacher would teach, and what it says of itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from analysis.style import INK, MUTED, short_label, styled, teacher_order
from analysis.task_axes import Axis
from tma_ray.tasks import MASTERY_RETURN

PANELS = 5
"""Equal parts of a run, one panel each."""

POINTS = 300
"""At most this many episodes are drawn in a panel, evenly spaced in time."""

RETURN_COLOURS = "viridis"
"""Perceptually uniform and readable with any colour vision."""

RETURNS = (-100.0, 300.0)
"""Range of the colours in the benchmark's worlds, in every report, from falling at once to crossing the
track; worlds with a mastery threshold of their own are coloured from the 2nd to the 98th percentile."""


@dataclass(frozen=True, eq=False)
class Curriculum:
    """What one run has to show of its curriculum.

    Attributes:
        episodes: step, task, world_task and episodic_return.
        probes: step and task.
        updates: step, gaussians, boxes and scalars of the teacher.
        steps: length of the run.
        mastery: episodic return over which a task is mastered.
    """

    episodes: pd.DataFrame
    probes: pd.DataFrame
    updates: pd.DataFrame
    steps: int
    mastery: float = MASTERY_RETURN

    @property
    def shuffled(self) -> bool:
        """Whether the teacher chooses in a shuffled space, which is not the world's."""
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

        return Curriculum(cut(self.episodes), cut(self.probes), cut(self.updates), self.steps, self.mastery)

    def probed_at(self, step: int) -> NDArray[np.float32]:
        """Returns the tasks of the last probe up to `step` (n, d); (0, 0) if the probes end before it."""
        steps = self.probes["step"]
        last = steps[steps <= step].max() if (steps >= step).any() else None
        return stack(self.probes.loc[steps == last, "task"])

    def update_at(self, step: int) -> pd.Series | None:
        """Returns the teacher's last update up to `step`, None if it had none."""
        earlier = self.updates[self.updates["step"] <= step].sort_values("step", kind="stable")
        return None if earlier.empty else earlier.iloc[-1]


def stack(tasks: pd.Series) -> NDArray[np.float32]:
    """Returns a column of tasks as one array (n, d); (0, 0) when there are none."""
    return np.stack(tasks.to_list()).astype(np.float32) if len(tasks) else np.empty((0, 0), np.float32)


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
    for row, teacher in zip(grid, teachers, strict=True):
        for part, axes in enumerate(row):
            _panel(axes, curricula[teacher].during(part), colours)
        row[0].set_ylabel(short_label(teacher, 16), fontweight="bold")
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


def label_plane(figure: Figure, axes: Axes, plane: tuple[Axis, Axis]) -> None:
    """Names the axes that all panels of `figure` share, and gives them the task space's bounds."""
    axes.set_xlim(plane[0].low, plane[0].high)
    axes.set_ylim(plane[1].low, plane[1].high)
    figure.supxlabel(plane[0].name, fontsize=8.5)
    figure.supylabel(plane[1].name, fontsize=8.5)


def frame(axes: Axes) -> None:
    """Draws a light frame around a small panel."""
    for spine in axes.spines.values():
        spine.set_visible(True)
        spine.set_color("#b9bec6")
    axes.tick_params(length=2)


def remark(axes: Axes, text: str) -> None:
    """Says in the middle of an empty panel why it is empty."""
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color=MUTED)


def _panel(axes: Axes, part: Curriculum, colours: ScalarMappable) -> None:
    frame(axes)
    if part.episodes.empty:
        remark(axes, "no episodes")
        return
    chosen = np.unique(np.linspace(0, len(part.episodes) - 1, POINTS).round().astype(int))
    tasks = part.tasks[chosen]
    returns = part.episodes["episodic_return"].to_numpy(float)[chosen]
    axes.scatter(tasks[:, 0], tasks[:, 1], c=colours.to_rgba(returns), s=10, linewidth=0.25, edgecolor=INK)


def return_range(curricula: Mapping[str, Curriculum], mastery: float) -> tuple[float, float]:
    """Returns the ends of the colours of returns: `RETURNS` in the benchmark's worlds."""
    if mastery == MASTERY_RETURN:
        return RETURNS
    returns = np.concatenate(
        [each.episodes["episodic_return"].to_numpy(float) for each in curricula.values()]
    )
    low, high = np.percentile([*returns, mastery], (2, 98))
    return min(low, mastery), max(high, mastery)
