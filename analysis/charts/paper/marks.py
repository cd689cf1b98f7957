"""Marks and legends drawn by matplotlib."""

from collections.abc import Sequence
from functools import singledispatch
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from matplotlib.transforms import ScaledTranslation

from analysis.charts import base
from analysis.teacher_styles import MUTED, RULE, TeacherStyle

STAR_ROW = 6.5  # height of a row of stars, in points

DIAMETER, THICKNESS = 0.55, 0.75
"""Points on paper per CSS pixel of a mark's diameter, and of a line's width."""


def draw_marks(axes: Axes, panel: base.Panel) -> None:
    """Draw the marks of a panel in `axes`, or only its `empty_text` if it has one."""
    if panel.empty_text:
        style: dict[str, Any] = {"ha": "center", "va": "center", "color": MUTED}
        axes.text(0.5, 0.5, panel.empty_text, transform=axes.transAxes, **style)
        return
    for mark in panel.marks:
        _draw(mark, axes, panel)
    for level, row in enumerate(reversed(panel.stars)):
        _draw_stars(row, axes, level)
    if not panel.x.bounded and panel.x.kind is base.AxisKind.STEPS:
        axes.set_xlim(0, max(axes.dataLim.x1, 1.0))
    if panel.x.kind is base.AxisKind.PERCENT and not panel.x.bounded:
        axes.set_xlim(0, max(axes.get_xlim()[1], base.LEAST_PERCENT))
    if panel.y.kind is base.AxisKind.PERCENT and not panel.y.bounded:
        axes.set_ylim(0, max(axes.get_ylim()[1], base.LEAST_PERCENT))


@singledispatch
def _draw(mark: base.Mark, *_: object) -> None:
    raise TypeError(f"{type(mark).__name__} is not drawn on paper: expected a mark of analysis.charts.base")


@_draw.register
def _(mark: base.Curve, axes: Axes, panel: base.Panel) -> None:
    """Draw a curve, with a thinner line beyond the last step that all runs have reached."""
    whole = np.ones(len(mark.x), bool) if mark.n is None else mark.n == mark.n.max()
    start, end = (int(index) for index in np.flatnonzero(whole)[[0, -1]])
    x, colour = mark.x[start:], mark.look.colour
    if mark.low is not None and mark.high is not None:
        low, high = mark.low[start:], mark.high[start:]
        axes.fill_between(x, low, high, color=colour, alpha=mark.opacity, linewidth=0)
    if mark.y is None:
        return
    y, end = mark.y[start:], end - start
    clipped = panel.y.bounded and not _within(panel.y, y)
    if end + 1 < len(x):
        axes.plot(x[end:], y[end:], color=colour, linewidth=0.7)
    axes.plot(
        x[: end + 1],
        y[: end + 1],
        color=colour,
        linestyle=mark.look.dashes,
        linewidth=THICKNESS * mark.width,
        marker=mark.look.marker if mark.width >= 1.5 else "",
        markevery=max(1, (end + 1) // 8),
        markerfacecolor=mark.fill or colour,
        markeredgecolor=colour if mark.fill else "white",
        markeredgewidth=0.5,
        clip_on=clipped,
        zorder=3,
        label=mark.name or None,
        gid=mark.svg_id or None,
    )


@_draw.register
def _(mark: base.Scatter, axes: Axes, panel: base.Panel) -> None:
    x, y = (np.asarray(values, np.float64) for values in (mark.x, mark.y))
    if mark.values is not None and mark.colours is not None:
        colour: Any = mappable(mark.colours).to_rgba(np.asarray(mark.values, np.float64))
    else:
        colour = mark.look.colour
    within = _within(panel.x, x) and _within(panel.y, y)
    style: dict[str, Any] = {"facecolors": "none", "edgecolors": colour} if mark.hollow else {"c": colour}
    if mark.edge and not mark.hollow:
        style |= {"edgecolors": mark.edge, "linewidths": 0.35}
    elif not mark.hollow:
        style |= {"linewidths": 0}
    axes.scatter(
        x,
        y,
        s=(DIAMETER * np.asarray(mark.size)) ** 2,
        marker=mark.look.marker or "o",
        alpha=mark.opacity,
        clip_on=not within,
        zorder=3,
        gid=mark.svg_id or None,
        **style,
    )


@_draw.register
def _(mark: base.Interval, axes: Axes, _: base.Panel) -> None:
    if not np.isfinite(mark.x):
        return
    sides = [[max(mark.x - mark.low, 0.0)], [max(mark.high - mark.x, 0.0)]] if np.isfinite(mark.low) else None
    axes.errorbar(
        mark.x,
        mark.y,
        xerr=sides,
        color=mark.look.colour,
        marker=mark.look.marker if mark.size else "",
        markersize=DIAMETER * mark.size,
        capsize=THICKNESS * mark.cap,
        linewidth=THICKNESS * mark.width,
        capthick=THICKNESS * mark.width,
        zorder=3,
    )


@_draw.register
def _(mark: base.Bar, axes: Axes, _: base.Panel) -> None:
    axes.barh(mark.y, mark.x, height=mark.height, color=mark.look.colour, alpha=mark.opacity)


@_draw.register
def _(mark: base.Heatmap, axes: Axes, _: base.Panel) -> None:
    colours = mark.colours
    few: dict[str, Any] = {"edgecolor": RULE, "linewidth": 0.4} if mark.values.size <= 400 else {}
    edges = _edges(mark.xs), _edges(mark.ys)
    axes.pcolormesh(*edges, mark.values, cmap=colours.name, vmin=colours.low, vmax=colours.high, **few)


@_draw.register
def _(mark: base.Polygons, axes: Axes, _: base.Panel) -> None:
    for outline in mark.outlines:
        colour, share = mark.look.colour, outline.weight
        fill: Any = (colour, 0.04 + 0.18 * share)
        edge: Any = (colour, 0.35 + 0.65 * share)
        width = 0.6 + 0.8 * share
        if outline.score is not None and mark.colours is not None:
            fill, edge, width = mappable(mark.colours).to_rgba(np.array(outline.score)), "white", 0.5
        corners = np.column_stack([outline.xs, outline.ys])
        axes.add_patch(Polygon(corners, facecolor=fill, edgecolor=edge, linewidth=width))


@_draw.register
def _(mark: base.ReferenceLine, axes: Axes, _: base.Panel) -> None:
    for line, position in ((axes.axvline, mark.x), (axes.axhline, mark.y)):
        if position is not None:
            line(
                position,
                color=mark.look.colour,
                linestyle=mark.look.dashes,
                linewidth=THICKNESS * mark.width,
                zorder=0.5,
                label=mark.name or None,
            )


@_draw.register
def _(mark: base.Label, axes: Axes, _: base.Panel) -> None:
    style: dict[str, Any] = {"color": mark.look.colour, "va": "center", "gid": mark.svg_id or None}
    if mark.beside:
        axes.annotate(mark.text, (mark.x, mark.y), xytext=(2, 0), textcoords="offset points", **style)
    else:
        axes.text(mark.x, mark.y, mark.text, ha="center", **style)


def _draw_stars(row: base.StarRow, axes: Axes, level: int) -> None:
    """Draw a row of stars above a panel, followed by the marker of their line."""
    colour = row.look.colour
    rise = ScaledTranslation(0, (5 + STAR_ROW * level) / 72, axes.figure.dpi_scale_trans)
    along = axes.get_xaxis_transform() + rise
    end = axes.transAxes + rise + ScaledTranslation(9 / 72, 0, axes.figure.dpi_scale_trans)
    for steps, marker, size, inside, transform, svg_id in (
        (row.above, "*", 5.5, colour, along, f"above-{row.svg_id}"),
        (row.below, "*", 5.5, "white", along, f"below-{row.svg_id}"),
        ([1], row.look.marker, 3.5, row.fill, end, None),
    ):
        if len(steps):  # constrained layout would reserve space even for an empty line
            axes.plot(
                list(steps),
                np.ones(len(steps)),
                transform=transform,
                linestyle="none",
                marker=marker,
                markersize=size,
                color=colour,
                markerfacecolor=inside,
                markeredgewidth=0.6,
                clip_on=False,
                gid=svg_id,
            )


def _within(axis: base.PanelAxis, values: base.Array) -> bool:
    if axis.low is None or axis.high is None:
        return bool(axis.rows)
    return bool(((values >= axis.low) & (values <= axis.high)).all())


def _edges(centres: base.Array) -> base.Array:
    """Return the edges (n + 1,) of the cells whose centres are `centres` (n,)."""
    if len(centres) < 2:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    middle = (centres[1:] + centres[:-1]) / 2
    return np.array([2 * centres[0] - middle[0], *middle, 2 * centres[-1] - middle[-1]])


def mappable(colours: base.ColourScale) -> ScalarMappable:
    """Return matplotlib's mapping from values to the colours of a scale."""
    return ScalarMappable(Normalize(colours.low, colours.high), colours.name)


CHARACTER = 0.6  # mean width of a character in units of the font size
HANDLE, COLUMN_GAP = 2.6, 1.2  # handle length and column spacing in units of the font size

POINTS_PER_INCH = 72


def line_handle(mark: base.Mark) -> Line2D:
    """Return the legend handle of a named mark."""
    fill = mark.fill if isinstance(mark, base.Curve) else ""
    marked = not isinstance(mark, base.Curve) or mark.width >= 1.5
    look = mark.look if marked else mark.look._replace(marker="")
    return look_handle(look, mark.name, fill, line=not isinstance(mark, base.Interval))


def look_handle(look: TeacherStyle, name: str, fill: str = "", line: bool = True) -> Line2D:
    """Return a legend handle in a given style."""
    edge = look.colour if fill and fill != look.colour else "white"
    style: dict[str, Any] = {"color": look.colour, "marker": look.marker, "markersize": 4, "linewidth": 1.3}
    style |= {
        "linestyle": look.dashes if line else "none",
        "markerfacecolor": fill or look.colour,
        "markeredgecolor": edge,
        "markeredgewidth": 0.5,
    }
    return Line2D([], [], label=name, **style)


def mark_handle(key: base.LegendEntry) -> Line2D:
    """Return the legend handle of a marker."""
    fill = key.colour if key.full else "white"
    style: dict[str, Any] = {"color": key.colour, "markerfacecolor": fill, "markeredgewidth": 0.7}
    return Line2D([], [], marker=key.marker, linestyle="none", markersize=key.size, label=key.name, **style)


def legend(figure: Figure, handles: Sequence[Line2D], loc: Any, size: float = 7, **options: Any) -> Legend:
    """Draw a legend for the whole figure, in as many columns as fit its width."""
    return figure.legend(
        handles=list(handles),
        loc=loc,
        ncols=_columns(handles, figure.get_figwidth(), size),
        fontsize=size,
        handlelength=HANDLE,
        columnspacing=COLUMN_GAP,
        handletextpad=0.5,
        labelspacing=0.35,
        borderpad=0.2,
        borderaxespad=0.2,
        **options,
    )


def legend_height(handles: Sequence[Line2D], width: float, size: float = 7) -> float:
    """Return the height of a `legend` in a figure of a given width, in inches."""
    rows = -(-len(handles) // _columns(handles, width, size))
    return (rows * 1.6 + 0.6) * size / POINTS_PER_INCH if handles else 0.0


def _columns(handles: Sequence[Line2D], width: float, size: float) -> int:
    em = size / POINTS_PER_INCH
    widths = [(len(str(handle.get_label())) * CHARACTER + 0.5) * em for handle in handles]
    gaps = (HANDLE + COLUMN_GAP) * em
    for columns in range(len(widths), 1, -1):
        # array_split distributes handles over columns as matplotlib does
        if sum(max(part) + gaps for part in np.array_split(widths, columns)) <= width - 0.1:
            return columns
    return 1
