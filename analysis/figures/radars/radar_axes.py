"""One panel of a radar chart: axes, rings, lines with gaps, and marks at the ends of axes."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.projections.polar import PolarAxes
from numpy.typing import NDArray

from analysis.looks import INK, MUTED, RULE, look

RADIUS = 0.86
"""Of the chart, inches."""

LABEL = 6.8
"""Size of the letters, points."""

STAR_GAP = 0.092
"""From one star to the next, inches."""

STAR_COLUMNS = 4
"""Stars side by side at one axis; more of them stand in further rows."""

STAR_ROWS = 2
"""With more rows of stars than these, their number is written."""

BEYOND = 0.16
"""Width of the band outside of the rings, over the radius of the outermost ring."""


class Star(NamedTuple):
    """A significant result: whose, and on which axis."""

    teacher: str
    axis: int


class RadarAxes:
    """A radar chart in a figure that is laid out in inches."""

    def __init__(
        self,
        figure: Figure,
        centre: tuple[float, float],
        titles: Sequence[str],
        high: float,
        beyond: bool = False,
    ) -> None:
        """Draws axes and rings.

        Args:
            figure: where to.
            centre: from the lower left corner, inches.
            titles: names of the axes, clockwise from the top.
            high: largest finite value; the rim is the next half above it.
            beyond: whether there are infinite values, which lie in a band outside of the rim.
        """
        self._figure, self._centre, self._titles = figure, centre, titles
        self.rim = max(1.5, math.ceil(high / 0.5 + 0.02) * 0.5)
        self.angles = 2 * np.pi * np.arange(len(titles)) / len(titles)
        width, height = figure.get_size_inches()
        (x, y), side = centre, 2 * RADIUS
        box = ((x - RADIUS) / width, (y - RADIUS) / height, side / width, side / height)
        axes = figure.add_axes(box, projection="polar")
        assert isinstance(axes, PolarAxes)
        self.axes = axes
        axes.set_theta_zero_location("N")
        axes.set_theta_direction(-1)
        outer = self.rim * (1 + BEYOND) if beyond else self.rim
        axes.set_ylim(0, outer)
        axes.set_axis_off()
        for angle in self.angles:
            axes.plot([angle, angle], [0, outer], color=RULE, linewidth=0.6, zorder=0)
        step = 0.5 if self.rim <= 2 else 1.0
        for ring in (*np.arange(step, self.rim, step), self.rim):
            self._ring(float(ring), color=RULE, linewidth=0.6, zorder=0)
        for ring in np.arange(1, self.rim + 0.01):
            self._name_ring(float(ring), f"{ring:g}")
        if beyond:
            self._ring(outer, color=RULE, linewidth=0.6, linestyle=(0, (2, 2)), zorder=0, gid="beyond")
            self._name_ring(outer, "\N{INFINITY}")
        random = look("random")
        self._ring(1.0, color=random.colour, linestyle=random.dashes, linewidth=1.1, zorder=1, gid="random")
        for axis, title in enumerate(titles):
            self._name_axis(axis, title)

    def title(self, text: str) -> None:
        """Writes what the panel shows above it."""
        self._write(0, RADIUS + 0.58, text, fontsize=8, fontweight="bold", ha="center", va="bottom")

    def note(self, text: str) -> None:
        """Writes what is missing below the panel."""
        self._write(0, -RADIUS - 0.42, text, fontsize=6, color=MUTED, ha="center", va="top", linespacing=1.25)

    def radius(self, value: float, share: float = 1.0) -> float:
        """Returns where a value lies: an infinite one at a `share` of the band beyond the rim."""
        return self.rim * (1 + BEYOND * share) if math.isinf(value) else value

    def line(self, teacher: str, values: Sequence[float], filled: Sequence[bool]) -> None:
        """Draws one teacher: a line where two neighbours have values, a mark on each axis that has one.

        Args:
            teacher: gives colour and mark.
            values: one for each axis, NaN for none.
            filled: whether its mark is full, for each axis.
        """
        style = look(teacher)
        around = [*range(len(values)), 0]
        shown = np.array([values[axis] for axis in around])
        self.axes.plot(
            np.append(self.angles, 2 * np.pi),
            shown,
            color=style.colour,
            linestyle=style.dashes,
            linewidth=1.1,
            zorder=2,
            label=teacher,
        )
        for angle, value, full in zip(self.angles, values, filled, strict=True):
            if math.isfinite(value):
                self.axes.plot(
                    [angle],
                    [value],
                    color=style.colour,
                    marker=style.marker,
                    markersize=3.4,
                    markerfacecolor=style.colour if full else "white",
                    markeredgewidth=0.7,
                    zorder=3,
                    clip_on=False,
                )

    def upper(self, values: Sequence[float]) -> None:
        """Draws a plus on each axis that has an upper baseline."""
        shown = [
            (angle, value) for angle, value in zip(self.angles, values, strict=True) if math.isfinite(value)
        ]
        if shown:
            angles, heights = zip(*shown, strict=True)
            self.axes.plot(
                angles,
                heights,
                linestyle="none",
                marker="+",
                color=INK,
                markersize=6,
                markeredgewidth=1.2,
                zorder=4,
                gid="upper",
            )

    def doubts(self, places: Iterable[tuple[int, float]]) -> None:
        """Writes a dagger beside the mark at each axis and radius."""
        for axis, radius in places:
            self.axes.annotate(
                "\N{DAGGER}",
                (self.angles[axis], radius),
                xytext=(3, 2),
                textcoords="offset points",
                fontsize=LABEL,
                gid="doubt",
                zorder=5,
            )

    def stars(self, stars: Sequence[Star]) -> None:
        """Draws stars in short rows beside the name of their axis, in the order given."""
        for axis in range(len(self._titles)):
            mine = [star for star in stars if star.axis == axis]
            anchor, align, up = self._place(axis)
            height = anchor[1] + up * (0.07 + 0.118 * len(self._lines(self._titles[axis])))
            if len(mine) > STAR_COLUMNS * STAR_ROWS:
                text, va = f"\N{BLACK STAR} {len(mine)} teachers", "center"
                self._write(anchor[0], height, text, fontsize=LABEL - 0.8, ha=align, va=va)
                continue
            for place, star in enumerate(mine):
                row, column = divmod(place, STAR_COLUMNS)
                reach = STAR_GAP * (min(STAR_COLUMNS, len(mine) - row * STAR_COLUMNS) - 1)
                first = anchor[0] - reach * {"left": 0.0, "center": 0.5, "right": 1.0}[align]
                first += {"left": 0.04, "center": 0.0, "right": -0.04}[align]
                x, y = self._centre[0] + first + STAR_GAP * column, self._centre[1] + height
                self._figure.add_artist(self._star(x, y + up * row * STAR_GAP, look(star.teacher).colour))

    def _star(self, x: float, y: float, colour: str) -> Line2D:
        return Line2D(
            [x],
            [y],
            transform=self._figure.dpi_scale_trans,
            marker="*",
            markersize=6.2,
            color=colour,
            markeredgewidth=0,
            linestyle="none",
        )

    def _ring(self, radius: float, **style: Any) -> None:
        around: NDArray[np.float64] = np.append(self.angles, 2 * np.pi)
        self.axes.plot(around, np.full(len(around), radius), **style)

    def _name_ring(self, ring: float, text: str) -> None:
        self.axes.annotate(
            text,
            (0, ring),
            xytext=(-2, 0),
            textcoords="offset points",
            fontsize=5.5,
            color=MUTED,
            ha="right",
            va="center",
        )

    def _name_axis(self, axis: int, title: str) -> None:
        (x, y), align, up = self._place(axis)
        lines = "\n".join(self._lines(title))
        va = "bottom" if up > 0 else "top"
        self._write(x, y, lines, fontsize=LABEL, ha=align, va=va, linespacing=1.05)

    def _place(self, axis: int) -> tuple[tuple[float, float], str, int]:
        """Returns where the name of an axis is anchored, how it is aligned, and if it grows up or down."""
        angle = float(self.angles[axis])
        x, y = RADIUS * math.sin(angle), RADIUS * math.cos(angle)
        if abs(x) < 0.05 * RADIUS:
            return (0.0, y + math.copysign(0.06, y)), "center", 1 if y > 0 else -1
        if y > -0.05 * RADIUS:  # in the corner that the axes leave free
            side = math.copysign(RADIUS + 0.17, x)
            return (side, y + 0.16), "right" if x > 0 else "left", 1
        return (x, y - 0.06), "center", -1

    @staticmethod
    def _lines(title: str) -> list[str]:
        return textwrap.wrap(title, 11) or [title]

    def _write(self, x: float, y: float, text: str, **style: Any) -> None:
        """Writes at a distance from the centre, in inches."""
        self._figure.text(
            self._centre[0] + x, self._centre[1] + y, text, transform=self._figure.dpi_scale_trans, **style
        )
