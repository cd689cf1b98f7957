"""Radar charts drawn by matplotlib."""

import itertools
import math
import textwrap
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.projections.polar import PolarAxes
from numpy.typing import NDArray

from analysis.charts.base import Chart
from analysis.charts.paper.marks import legend, legend_height, look_handle, mark_handle
from analysis.charts.radars import BEYOND, HEIGHT, Radar
from analysis.data.reference import BASELINE, is_baseline
from analysis.names import teacher_order
from analysis.teacher_styles import INK, MUTED, RULE, shown_together, teacher_style

CENTRE, RADIUS = 1.36, 0.86
"""Height of a radar's centre above its lower edge, and radius of its rim, in inches."""

STAR_GAP = 0.092  # distance between neighbouring stars, in inches

STAR_COLUMNS, STAR_ROWS = 4, 2
"""Largest numbers of columns and rows of stars at an axis; more stars are replaced by their number."""


def draw_radars(chart: Chart) -> Figure:
    """Return a figure with rows of radar charts, each row with a legend of its teachers."""
    width, size = chart.size[0], chart.letters
    marks = [mark_handle(key) for key in chart.keys]
    rows = [dict(item for radar in row for item in radar.teachers.items()) for row in chart.panels]
    with shown_together(itertools.chain(*rows)):
        named = [
            [look_handle(teacher_style(teacher), row[teacher]) for teacher in sorted(row, key=teacher_order)]
            for row in rows
        ]
        heights = [legend_height(handles, width, size) for handles in (marks, *named)]
        total = chart.size[1] + sum(heights)
        figure = Figure(figsize=(width, total))
        legend(figure, marks, "upper center", size, bbox_to_anchor=(0.5, 1.0))
        top = total - heights[0]
        for row, handles, height in zip(chart.panels, named, heights[1:], strict=True):
            legend(figure, handles, "upper center", size, bbox_to_anchor=(0.5, top / total))
            top -= HEIGHT + height
            for column, radar in enumerate(row):
                RadarAxes(figure, (width * (column + 0.5) / len(row), top + CENTRE), radar, size).draw()
    return figure


class RadarAxes:
    """Polar axes on which one radar is drawn, with its centre in inches and its font size in points."""

    def __init__(self, figure: Figure, centre: tuple[float, float], radar: Radar, size: float) -> None:
        self._figure, self._centre, self._radar, self._size = figure, centre, radar, size
        self._angles: NDArray[np.float64] = 2 * np.pi * np.arange(len(radar.axes)) / len(radar.axes)
        width, height = figure.get_size_inches()
        (x, y), side = centre, 2 * RADIUS
        box = ((x - RADIUS) / width, (y - RADIUS) / height, side / width, side / height)
        axes = figure.add_axes(box, projection="polar")
        assert isinstance(axes, PolarAxes)
        self._axes = axes

    def draw(self) -> None:
        """Draw the radar chart."""
        radar = self._radar
        self._draw_rings()
        for axis, name in enumerate(radar.axes):
            (x, y), align, up = self._anchor(axis)
            va = "bottom" if up > 0 else "top"
            self._write(x, y, _folded(name), fontsize=self._size, ha=align, va=va, linespacing=1.05)
        centre: dict[str, Any] = {"ha": "center", "fontsize": 8, "fontweight": "bold"}
        self._write(0, RADIUS + 0.58, radar.title, va="bottom", **centre)
        if radar.note:
            note = centre | {"fontsize": 6, "fontweight": "normal", "color": MUTED, "linespacing": 1.25}
            self._write(0, -RADIUS - 0.42, "\n".join(radar.note), va="top", **note)
        for teacher in radar.teachers:
            self._draw_line(teacher)
        upper = np.array(radar.results.upper)
        upper[np.isinf(upper)] = radar.rim * (1 + BEYOND)
        finite = np.isfinite(upper)
        if finite.any():
            plus: dict[str, Any] = {"marker": "+", "markersize": 6, "markeredgewidth": 1.2, "color": INK}
            self._axes.plot(
                self._angles[finite], upper[finite], linestyle="none", zorder=4, gid="upper", **plus
            )
        for teacher, axis in sorted(radar.results.doubts):
            if teacher in radar.teachers:
                point = self._angles[axis], radar.radius(teacher, axis)
                style: dict[str, Any] = {"textcoords": "offset points", "fontsize": self._size, "zorder": 5}
                self._axes.annotate("\N{DAGGER}", point, xytext=(3, 2), gid="doubt", **style)
        for axis in range(len(radar.axes)):
            self._draw_stars(axis)

    def _draw_rings(self) -> None:
        axes, rim = self._axes, self._radar.rim
        axes.set_theta_zero_location("N")
        axes.set_theta_direction(-1)
        outer = rim * (1 + BEYOND) if self._radar.beyond else rim
        axes.set_ylim(0, outer)
        axes.set_axis_off()
        fine: dict[str, Any] = {"color": RULE, "linewidth": 0.6, "zorder": 0}
        for angle in self._angles:
            axes.plot([angle, angle], [0, outer], **fine)
        step = 0.5 if rim <= 2 else 1.0
        for ring in (*np.arange(step, rim, step), rim):
            self._ring(float(ring), **fine)
        for ring in np.arange(1, rim + 0.01):
            self._name_ring(float(ring), f"{ring:g}")
        if self._radar.beyond:
            self._ring(outer, linestyle=(0, (2, 2)), gid="beyond", **fine)
            self._name_ring(outer, "\N{INFINITY}")
        random = teacher_style(BASELINE)
        self._ring(1.0, color=random.colour, linestyle=random.dashes, linewidth=1.1, zorder=1, gid=BASELINE)

    def _draw_line(self, teacher: str) -> None:
        """Draw a teacher's line and markers, with a gap where a value is missing."""
        radar, style = self._radar, teacher_style(teacher)
        radii = [radar.radius(teacher, axis) for axis in range(len(radar.axes))]
        line: dict[str, Any] = {"linestyle": style.dashes, "linewidth": 1.1, "zorder": 2, "label": teacher}
        around = np.append(self._angles, 2 * np.pi)
        self._axes.plot(around, np.array([*radii, radii[0]]), color=style.colour, **line)
        for axis, (angle, value) in enumerate(zip(self._angles, radii, strict=True)):
            full = is_baseline(teacher) or (teacher, axis) in radar.results.differ
            if math.isfinite(value):
                self._axes.plot(
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

    def _draw_stars(self, axis: int) -> None:
        """Draw a star beside the axis's name for each teacher that is better than Random."""
        radar = self._radar
        better = {who for (who, index), gap in radar.results.differ.items() if index == axis and gap > 0}
        teachers = sorted(better & set(radar.teachers), key=teacher_order)
        (x, y), align, up = self._anchor(axis)
        height = y + up * (0.07 + 0.118 * len(_folded(radar.axes[axis]).split("\n")))
        if len(teachers) > STAR_COLUMNS * STAR_ROWS:
            text = f"\N{BLACK STAR} {len(teachers)} teachers"
            self._write(x, height, text, fontsize=self._size - 0.8, ha=align, va="center")
            return
        for index, teacher in enumerate(teachers):
            row, column = divmod(index, STAR_COLUMNS)
            reach = STAR_GAP * (min(STAR_COLUMNS, len(teachers) - row * STAR_COLUMNS) - 1)
            first = x - reach * {"left": 0.0, "center": 0.5, "right": 1.0}[align]
            first += {"left": 0.04, "center": 0.0, "right": -0.04}[align]
            self._figure.add_artist(
                Line2D(
                    [self._centre[0] + first + STAR_GAP * column],
                    [self._centre[1] + height + up * row * STAR_GAP],
                    transform=self._figure.dpi_scale_trans,
                    marker="*",
                    markersize=6.2,
                    color=teacher_style(teacher).colour,
                    markeredgewidth=0,
                    linestyle="none",
                )
            )

    def _ring(self, radius: float, **style: Any) -> None:
        around = np.append(self._angles, 2 * np.pi)
        self._axes.plot(around, np.full(len(around), radius), **style)

    def _name_ring(self, ring: float, text: str) -> None:
        style: dict[str, Any] = {"fontsize": 5.5, "color": MUTED, "ha": "right", "va": "center"}
        self._axes.annotate(text, (0, ring), xytext=(-2, 0), textcoords="offset points", **style)

    def _anchor(self, axis: int) -> tuple[tuple[float, float], str, int]:
        """Return the position, alignment and vertical direction (1 up, -1 down) of an axis label."""
        angle = float(self._angles[axis])
        x, y = RADIUS * math.sin(angle), RADIUS * math.cos(angle)
        if abs(x) < 0.05 * RADIUS:
            return (0.0, y + math.copysign(0.06, y)), "center", 1 if y > 0 else -1
        if y > -0.05 * RADIUS:
            side = math.copysign(RADIUS + 0.17, x)
            return (side, y + 0.16), "right" if x > 0 else "left", 1
        return (x, y - 0.06), "center", -1

    def _write(self, x: float, y: float, text: str, **style: Any) -> None:
        """Write `text` at an offset from the centre, in inches."""
        position = self._centre[0] + x, self._centre[1] + y
        self._figure.text(*position, text, transform=self._figure.dpi_scale_trans, **style)


def _folded(name: str) -> str:
    return textwrap.fill(name, 11) or name
