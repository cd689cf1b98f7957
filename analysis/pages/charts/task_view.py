"""Tasks, boxes and Gaussians of a task space as points and lines of a chart."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.data.task_axes import Axis
from analysis.pages.charts.chart import axis, shown, task_axis

Array = NDArray[np.float64]

Outline = tuple[Array, Array]
"""xs and ys of a closed line."""

CORNERS = 33
"""Points of an ellipse."""

BOX, GAUSSIAN = 0.3, 0.2
"""Half the width of either in a dimension's column."""

GOLDEN = 0.618034
"""Multiples of it, less their whole part, spread evenly however many there are."""


@dataclass(frozen=True)
class TaskView:
    """How tasks are shown: on the task plane where it has two dimensions that vary.

    Else in a column for each dimension that varies, at their share of its range.

    Attributes:
        axes: the dimensions of the task space.
    """

    axes: tuple[Axis, ...]

    @property
    def varied(self) -> list[int]:
        """Places of the dimensions that vary."""
        return [place for place, dimension in enumerate(self.axes) if dimension.low < dimension.high]

    @property
    def plane(self) -> bool:
        """Whether tasks are points of a plane."""
        return len(self.axes) == len(self.varied) == 2

    def dots(self, tasks: Array) -> tuple[list[float], list[float]]:
        """Returns xs and ys of `tasks` (n, d): one dot each on a plane, else one in every column."""
        if self.plane:
            return rounded(tasks[:, 0]), rounded(tasks[:, 1])
        spread = 0.16 * (2 * ((np.arange(len(tasks)) * GOLDEN) % 1) - 1)
        columns = np.arange(len(self.varied)) + spread[:, None]
        return rounded(columns.ravel()), rounded(self._shares(tasks).ravel())

    def boxes(self, boxes: Iterable[Mapping[str, Any]]) -> dict[str, list[float | None]]:
        """Returns the outlines of boxes (low, high) as xs and ys of one trace."""
        ends = [[np.asarray(box[end], np.float64) for end in ("low", "high")] for box in boxes]
        if self.plane:
            return _joined(_rectangle(low, high) for low, high in ends)
        return _joined(outline for low, high in ends for outline in self._spans(low, high, BOX))

    def gaussians(self, gaussians: Iterable[Mapping[str, Any]]) -> dict[str, list[float | None]]:
        """Returns the outlines of Gaussians (mean, covariance), at two standard deviations, as `boxes`."""
        outlines: list[Outline] = []
        for gaussian in gaussians:
            mean = np.asarray(gaussian["mean"], dtype=np.float64)
            covariance = np.array([list(row) for row in gaussian["covariance"]], dtype=np.float64)
            if self.plane:
                outlines.append(_ellipse(mean, covariance))
            else:
                reach = 2 * np.sqrt(np.maximum(np.diag(covariance), 0.0))
                outlines += self._spans(mean - reach, mean + reach, GAUSSIAN)
        return _joined(outlines)

    def layout(self) -> dict[str, Any]:
        """Returns the axes of a chart."""
        if self.plane:
            return {
                f"{letter}axis": task_axis(each) | {"range": [each.low, each.high]}
                for letter, each in zip("xy", self.axes, strict=True)
            }
        names = [shown(self.axes[place].name.partition(" (")[0]) for place in self.varied]
        places = list(range(len(names)))
        return {
            "xaxis": axis(tickvals=places, ticktext=names, range=[-0.5, len(names) - 0.5], showgrid=False),
            "yaxis": axis("Share of the range", range=[-0.02, 1.02], tickformat=".0%"),
        }

    def _shares(self, tasks: Array) -> Array:
        """Returns varied dimensions of tasks (…, d) as shares of their ranges (…, v)."""
        low, high = np.array([[self.axes[place].low, self.axes[place].high] for place in self.varied]).T
        return np.asarray((tasks[..., self.varied] - low) / (high - low), dtype=np.float64)

    def _spans(self, low: Array, high: Array, half: float) -> list[Outline]:
        ends = np.clip(self._shares(np.stack([low, high])), 0.0, 1.0)
        return [
            _rectangle(np.array([column - half, bottom]), np.array([column + half, top]))
            for column, (bottom, top) in enumerate(ends.T)
        ]


def rounded(values: Sequence[float] | Array) -> list[float]:
    """Returns values with as many digits as a reader can tell apart."""
    return [float(f"{value:.4g}") for value in values]


def _rectangle(low: Array, high: Array) -> Outline:
    (left, bottom), (right, top) = low, high
    return np.array([left, right, right, left, left]), np.array([bottom, bottom, top, top, bottom])


def _ellipse(mean: Array, covariance: Array) -> Outline:
    angles = np.linspace(0, 2 * np.pi, CORNERS)
    values, vectors = np.linalg.eigh(covariance)
    circle = np.stack([np.cos(angles), np.sin(angles)])
    edge = vectors @ (2 * np.sqrt(np.maximum(values, 0.0))[:, None] * circle)
    return mean[0] + edge[0], mean[1] + edge[1]


def _joined(outlines: Iterable[Outline]) -> dict[str, list[float | None]]:
    """Returns outlines as one trace, with a gap after each."""
    xs: list[float | None] = []
    ys: list[float | None] = []
    for x, y in outlines:
        xs += [*rounded(x), None]
        ys += [*rounded(y), None]
    return {"x": xs, "y": ys}
