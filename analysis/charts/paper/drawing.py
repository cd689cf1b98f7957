"""Charts drawn by matplotlib, as figures or as animated GIFs."""

import functools
import textwrap
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import XAxis, YAxis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, MaxNLocator, PercentFormatter
from numpy.typing import NDArray

from analysis.charts.base import AxisKind, Chart, Curve, Heatmap, Legend, Panel, PanelAxis
from analysis.charts.paper.marks import (
    STAR_ROW,
    draw_marks,
    legend,
    legend_height,
    line_handle,
    mappable,
    mark_handle,
)
from analysis.charts.paper.radar import draw_radars
from analysis.charts.paper.style import P, styled
from analysis.charts.radars import Radar
from analysis.formatting import steps_text
from analysis.teacher_styles import MUTED
from tma_ray.support.gifs import gif_bytes

FRAME = "#b9bec6"
"""Colour of frames around panels of the task space."""

NARROW_GAP, WIDE_GAP = 0.08, 0.3
"""Space between panels side by side, without and with numbers at their vertical axes, in inches."""

ANIMATION_DPI = 90  # resolution of an animation, in dots per inch
Drawn = dict[Panel, Axes]  # axes of each panel of a chart, row by row


def figure_of(chart_of: Callable[P, Chart]) -> Callable[P, Figure]:
    """Decorate a function that returns a chart so that it returns a matplotlib figure."""

    @functools.wraps(chart_of)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> Figure:
        return draw(chart_of(*args, **kwargs))

    return drawn


@styled
def draw(chart: Chart) -> Figure:
    """Draw a chart as a matplotlib figure, with animated panels at their initial moment."""
    if isinstance(chart.all_panels[0], Radar):
        return draw_radars(chart)
    size, names = chart.letters, ("font.size", "axes.labelsize", "xtick.labelsize", "ytick.labelsize")
    letters: Any = {**dict.fromkeys(names, size), "axes.titlesize": size + (1 if size > 8 else 0.5)}
    with mpl.rc_context(letters):
        figure, drawn = lay_out(chart)
        for panel, axes in drawn.items():
            draw_marks(axes, panel)
        finish(figure, drawn, chart)
    return figure


@styled
def animate(chart: Chart, seconds: float = 6.0) -> bytes:
    """Return a chart as a looping GIF with a frame per moment of its panels.

    Args:
        chart: chart whose panels all have the same moments.
        seconds: length of the animation, besides another second for the last frame.
    """
    frames = list(_frames(chart))
    return gif_bytes(frames, seconds / len(frames), pause=1.0)


def _frames(chart: Chart) -> Iterator[NDArray[np.uint8]]:
    figure, drawn = lay_out(chart)
    figure.set_dpi(ANIMATION_DPI)
    canvas = FigureCanvasAgg(figure)
    for step in chart.all_panels[0].moments:
        for panel, axes in drawn.items():
            for artist in (*axes.collections, *axes.patches, *axes.texts):
                artist.remove()
            draw_marks(axes, panel.at(step))
        figure.suptitle(f"{steps_text(step)} steps" if step else "start", fontsize=9)
        canvas.draw()  # type: ignore[no-untyped-call]
        figure.set_layout_engine("none")  # to keep the layout of the first frame
        yield np.array(canvas.buffer_rgba())[..., :3]  # type: ignore[no-untyped-call]


def lay_out(chart: Chart) -> tuple[Figure, Drawn]:
    """Return a figure and the axes of each panel, empty but with bounds, ticks and headings."""
    rows, columns = len(chart.panels), len(chart.panels[0])
    width, height = chart.size
    top = chart.legend in (Legend.TOP, Legend.BESIDE)
    height += legend_height(_handles(chart), width) if top else 0.0
    figure = Figure(figsize=(width, height), layout="constrained")
    xs, ys = ([[panel and getattr(panel, side) for panel in row] for row in chart.panels] for side in "xy")
    shared: dict[str, Any] = {"sharex": _shared(xs), "sharey": _shared(ys)}
    if columns == 1 and shared["sharey"] != "all":
        shared["height_ratios"] = [len(panel.y.rows) or 1 for (panel,) in chart.panels]
    subplots = figure.subplots(rows, columns, squeeze=False, **shared)
    ticks = int(np.clip(2 * (width - 1) / columns, 2, 6))
    between = (columns - 1) * (WIDE_GAP if shared["sharey"] == "none" else NARROW_GAP)
    letters = int((width - 0.8 - between) / columns * 72 / (0.66 * (chart.letters + 0.5)))
    drawn: Drawn = {}
    for line, row in enumerate(chart.panels):
        for axes, panel, *beneath in zip(subplots[line], *chart.panels[line:], strict=True):
            if panel is None:
                axes.remove()
                continue
            drawn[panel] = axes
            _prepare(axes, panel, ticks, letters)
            if shared["sharex"] == "all" and not any(beneath):
                axes.tick_params(labelbottom=True)
            if shared["sharex"] == "row" and any(other and other.x == panel.x for other in beneath):
                axes.tick_params(labelbottom=False)
        if row[0] and row[0].side:
            subplots[line, 0].set_ylabel(textwrap.fill(row[0].side, 18), fontweight="bold")
    _name_axes(figure, drawn, chart)
    return figure, drawn


def _shared(grid: Sequence[Sequence[PanelAxis | None]]) -> str:
    """Return the value of matplotlib's ``sharex`` or ``sharey``: "all", "row" or "none"."""
    rows = [[axis for axis in row if axis is not None] for row in grid]
    if not all(axis.bounded or axis.rows for row in rows for axis in row):
        return "none"
    if all(axis == rows[0][0] for row in rows for axis in row):
        return "all"
    return "row" if all(axis == row[0] for row in rows for axis in row) else "none"


def _prepare(axes: Axes, panel: Panel, ticks: int, letters: int) -> None:
    """Set the bounds, ticks, frame and heading of empty axes."""
    flat = panel.x.kind is AxisKind.STEPS and panel.y.kind is AxisKind.TASK
    _prepare_axis(axes.xaxis, panel.x, ticks)
    _prepare_axis(axes.yaxis, panel.y, ticks, flat)
    if AxisKind.TASK in (panel.x.kind, panel.y.kind):
        axes.spines[:].set(visible=True, color=panel.frame or FRAME)
        axes.tick_params(length=2)
    if any(isinstance(mark, Heatmap) for mark in panel.marks) or not panel.x.shown:
        axes.spines[:].set_visible(False)
    if panel.title:
        texts = [line for text in (panel.title, panel.subtitle) for line in textwrap.wrap(text, letters)]
        pad = 4 + STAR_ROW * len(panel.stars)
        weight = "normal" if panel.side and panel.x.kind is AxisKind.TASK else "bold"
        axes.set_title("\n".join(texts), pad=pad, fontweight=weight)


def _prepare_axis(axis: XAxis | YAxis, scale: PanelAxis, ticks: int, flat: bool = False) -> None:
    """Set the bounds and ticks of an axis; a `flat` axis has ticks only at its bounds."""
    upright = isinstance(axis, YAxis)
    bounds = axis.axes.set_ylim if upright else axis.axes.set_xlim
    axis.grid(scale.grid)
    axis.set_visible(scale.shown)
    if scale.low is not None and scale.high is not None:
        margin = 0.04 * (scale.high - scale.low) if flat else 0.0
        bounds(scale.low - margin, scale.high + margin)
        if flat:
            axis.set_ticks([scale.low, scale.high])
        if scale.last_tick is not None:
            values = MaxNLocator(4).tick_values(scale.low, scale.last_tick)
            axis.set_ticks([tick for tick in values if scale.low <= tick <= scale.last_tick])
    if scale.rows:
        names = list(scale.rows.values())
        turned: dict[str, Any] = {"rotation": 90} if scale.kind is AxisKind.TEACHERS and not upright else {}
        axis.set_ticks(range(len(names)), names, **turned)
        axis.set_tick_params(length=0)
        bounds(*((len(names) - 0.4, -0.6) if upright else (-0.6, len(names) - 0.4)))
    if scale.kind is AxisKind.STEPS or scale.whole:
        count = round((scale.high or 0) - (scale.low or 0)) if scale.each_whole else ticks
        axis.set_major_locator(MaxNLocator(count, integer=scale.whole))
    if scale.kind is AxisKind.SHARE:
        axis.set_major_formatter(PercentFormatter(1.0))


def _name_axes(figure: Figure, drawn: Drawn, chart: Chart) -> None:
    """Add the titles of the axes, once for all panels if they are the same."""
    for side, share, name in (("x", figure.supxlabel, "set_xlabel"), ("y", figure.supylabel, "set_ylabel")):
        titles = {getattr(panel, side).title for panel in chart.all_panels} - {""}
        kinds = {(panel.x.kind, getattr(panel, side).kind) for panel in chart.all_panels}
        flat = side == "y" and kinds == {(AxisKind.STEPS, AxisKind.TASK)}
        once = len(titles) == 1 and len(chart.all_panels) > 1 and not flat
        if once and not (side == "x" and chart.note):  # a note is drawn where a common title would be
            share(_axis_title(chart.all_panels[0], side), fontsize=min(8.5, chart.letters + 1))
            continue
        for row in chart.panels[-1:] if once else chart.panels:
            for panel in filter(None, row[:1] if flat else row):
                text = _axis_title(panel, side)
                if flat and len(text) > 22:
                    words, bracket, unit = text.partition(" (")
                    text = "\n".join(textwrap.wrap(words, 22) + ([f"({unit}"] if bracket else []))
                if text:
                    getattr(drawn[panel], name)(text, **(FLAT if flat else {}))
    if len(chart.panels) > 1 and chart.panels[0][0] is not None:
        figure.align_ylabels([drawn[row[0]] for row in chart.panels if row[0] is not None])


FLAT: dict[str, Any] = {"rotation": 0, "ha": "right", "va": "center", "labelpad": 2}
"""Style of the title of a flat panel's axis."""


def _axis_title(panel: Panel, side: str) -> str:
    axis: PanelAxis = getattr(panel, side)
    unit = _step_unit(panel)[1] if axis.kind is AxisKind.STEPS and axis.title else ""
    return f"{axis.title} ({unit})" if unit else axis.title


def _step_unit(panel: Panel) -> tuple[float, str]:
    """Return the unit of a panel's steps: its size and its name, such as 1e6 and "millions"."""
    ends = [float(mark.x.max()) for mark in panel.marks if isinstance(mark, Curve) and len(mark.x)]
    high = panel.x.high if panel.x.high is not None else max(ends, default=1.0)
    units = ((1e6, "millions"), (1e3, "thousands"))
    return next(((size, name) for size, name in units if high >= 2 * size), (1.0, ""))


def finish(figure: Figure, drawn: Drawn, chart: Chart) -> None:
    """Add colour bars, legends, heading and note around the panels."""
    for panel, axes in drawn.items():
        if panel.x.kind is AxisKind.STEPS:
            unit, _ = _step_unit(panel)
            axes.xaxis.set_major_formatter(FuncFormatter(lambda step, _, unit=unit: f"{step / unit:g}"))
    _colour_bars(figure, drawn, chart)
    handles = _handles(chart)
    if chart.legend is Legend.CORNER:
        figure.legend(handles=handles, loc="upper right", fontsize=7, labelspacing=0.35)
    elif handles and chart.legend is not Legend.NONE:
        legend(figure, handles, "outside upper center")
    if chart.legend is Legend.BESIDE:
        for panel, axes in drawn.items():
            named = [line_handle(mark) for mark in panel.marks if mark.name]
            position: dict[str, Any] = {"loc": "center left", "bbox_to_anchor": (1.03, 0.5)}
            axes.legend(handles=named, fontsize=6, handlelength=2.6, **position)
    if chart.heading:
        figure.suptitle(chart.heading, fontsize=chart.letters + 1)
    if chart.note:
        wide = int(figure.get_figwidth() * 17)
        lines = [line for note in chart.note.split("\n") for line in textwrap.wrap(note, wide)]
        figure.supxlabel("\n".join(lines), fontsize=7, x=0.02, ha="left", linespacing=1.35)


def _handles(chart: Chart) -> list[Line2D]:
    """Return the legend handles of a chart's named marks and of its `keys`."""
    marks = {mark.name: mark for panel in chart.all_panels for mark in panel.marks if mark.name}
    lines = [] if chart.legend is Legend.BESIDE else [line_handle(mark) for mark in marks.values()]
    return [*lines, *map(mark_handle, chart.keys)]


def _colour_bars(figure: Figure, drawn: Drawn, chart: Chart) -> None:
    """Draw one colour bar if all rows share a colour scale, else one per row that has a scale."""
    scales = [
        next((c for p in row if p for mark in p.marks if (c := getattr(mark, "colours", None))), None)
        for row in chart.panels
    ]
    same = scales[0] is not None and all(colours == scales[0] for colours in scales)
    rows = [[drawn[panel] for panel in row if panel] for row in chart.panels]
    for colours, panels in [(scales[0], list(drawn.values()))] if same else zip(scales, rows, strict=True):
        if colours is None:
            continue
        bar = figure.colorbar(
            mappable(colours),
            ax=panels,
            extend="both" if colours.open else "neither",
            fraction=0.03 if same else 0.02,
            pad=0.01,
            aspect=22 if same else 14,
        )
        bar.set_label(colours.title)
        bar.outline.set_visible(False)
        bar.ax.tick_params(color=MUTED)
        if colours.mark is not None:
            bar.ax.axhline(colours.mark, color="white", linewidth=1.2)
