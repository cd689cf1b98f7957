"""Curricula of any number of dimensions: the spread of the tasks a teacher would teach, over time."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.data.curricula import Curriculum, boxes_of, gaussians_of
from analysis.data.task_axes import Axis
from analysis.figures.elements.axes import share_step_label, step_axis
from analysis.figures.elements.task_planes import frame
from analysis.figures.style import styled
from analysis.looks import INK, look
from analysis.names import short_labels, teacher_order

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
