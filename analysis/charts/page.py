"""Charts on pages, as data for plotly.js, with frames that hold only differences from the initial view."""

import base64
import gzip
import html
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache, singledispatch
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from plotly.colors import get_colorscale
from plotly.io.json import to_json_plotly
from plotly.offline import get_plotlyjs

from analysis.charts import base
from analysis.names import mark_of, teacher_order
from analysis.teacher_styles import INK, MUTED, RULE, TeacherStyle

FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"

ROW, ROWS_FRAME = 34, 76  # heights of a teacher's row, and of the axis with margins, in CSS pixels

SPACING, LEAST_HEIGHT, COMPARISONS_FRAME = 11, 30, 130
"""Height of each mean, minimum height of a comparison's row, height of axis and legend, in CSS pixels."""

MOST_ACROSS = 4  # maximum number of plots side by side

BINARY = {"float32": "f4", "float64": "f8", "int32": "i4"}
"""Names in plotly.js of the array types that are embedded as bytes, by their names in numpy."""

_SYMBOLS = {
    "": "circle", "o": "circle", "s": "square", "D": "diamond", "^": "triangle-up", "v": "triangle-down",
    "P": "cross", "X": "x", "p": "pentagon", "h": "hexagon", "<": "triangle-left", ">": "triangle-right",
    "*": "star", "d": "diamond-tall",
}  # fmt: skip
"""Symbols in plotly.js, by matplotlib marker."""

Trace: TypeAlias = dict[str, Any]  # trace of plotly.js


@dataclass(frozen=True, eq=False)
class Plot:
    """Panel of a chart as plain data for plotly.js, without the slow validation by plotly's classes."""

    name: str  # identifier on the page, and file name of saved pictures
    title: str  # title of the chart
    teacher: str  # teacher of the panel; empty for several
    traces: tuple[Trace, ...]  # traces; pages hide them by the teacher and comparison in their ``meta``
    layout: dict[str, Any]  # axes, margins, legend
    frames: tuple[dict[str, Any], ...]  # animation frames, each a moment's name and the traces that change

    @property
    def json(self) -> str:
        """Plot as JSON."""
        data = {"data": list(self.traces), "layout": self.layout, "frames": list(self.frames)}
        return str(to_json_plotly(_compact(data)))


@dataclass(frozen=True, eq=False)
class PageChart:
    """Plots of a chart under a common caption, with `across` plots side by side."""

    title: str
    caption: str
    plots: tuple[Plot, ...]
    across: int


def on_page(chart: base.Chart) -> PageChart:
    """Convert a chart to a `PageChart`, with a plot per panel."""
    counts, seen, plots = Counter(panel.teacher for panel in chart.all_panels), Counter[str](), []
    for panel in chart.all_panels:
        seen[panel.teacher] += 1
        number = str(seen[panel.teacher]) if counts[panel.teacher] > 1 or panel.subtitle else ""
        name = "-".join(filter(None, [chart.name, panel.teacher, number]))
        traces, frames = _traces(panel), []
        for moment in panel.moments:
            shown = panel.at(moment)
            changes = [_change(old, new) for old, new in zip(traces, _traces(shown), strict=True)]
            indices = [index for index, change in enumerate(changes) if change]
            frames.append(
                {"name": str(moment), "traces": indices, "data": [changes[index] for index in indices]}
                | ({"layout": {"title": {"text": _heading(shown)}}} if shown.title != panel.title else {})
            )
        layout = _layout(chart, panel)
        plots.append(Plot(name, chart.title, panel.teacher, tuple(traces), layout, tuple(frames)))
    return PageChart(chart.title, chart.caption, tuple(plots), min(len(plots), MOST_ACROSS))


@cache
def plotly_library() -> str:
    """Return plotly.js with its URLs removed, `packed` for a script element."""
    # string literals that are a URL, except XML namespaces
    address = r"""(["'`])https?://(?!www\.w3\.org/)[^"'`]*\1"""
    return packed(re.sub(address, r"\1\1", str(get_plotlyjs())))


def packed(text: str) -> str:
    """Return `text` as base64-encoded gzip, safe within a script element and unpacked by page.js."""
    return base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode()


def _change(old: Trace, new: Trace) -> Trace:
    """Return the entries of `new` that differ from `old`, comparing markers and error bars entry by entry."""
    change = {}
    for key, value in new.items():
        if key in ("marker", "error_x"):
            value = {name: part for name, part in value.items() if not _same(part, old[key].get(name))}
            if value:
                change[key] = value
        elif not _same(value, old.get(key)):
            change[key] = value
    return change


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        return np.array_equal(one, other)
    return bool(one == other)


def _traces(panel: base.Panel) -> list[Trace]:
    """Return the traces of a panel, with one legend entry for all traces of the same name."""
    traces, named = [], set[str]()
    for mark in panel.marks:
        for trace in _traces_of(mark, panel):
            owners = {"teacher": mark.teacher, "comparison": mark.comparison}
            meta = {name: value for name, value in owners.items() if value}
            shown = bool(mark.name) and trace.get("showlegend", True) and mark.name not in named
            trace |= {"name": _shown(mark.name), "meta": meta, "showlegend": shown}
            if mark.name:
                trace |= {"legendgroup": mark.teacher or mark.name}
                trace |= {"legendrank": 999} if mark_of(mark.teacher) else {}
            named |= {mark.name} if shown else set()
            traces.append(trace)
    return traces


@singledispatch
def _traces_of(mark: base.Mark, _: base.Panel) -> Iterator[Trace]:
    """Yield the traces of a mark.

    Raises:
        TypeError: if pages do not draw this type of mark.
    """
    raise TypeError(f"{type(mark).__name__} is not drawn on pages: expected a mark of analysis.charts.base")


@_traces_of.register
def _(mark: base.Curve, _: base.Panel) -> Iterator[Trace]:
    colour = mark.look.colour
    if mark.low is not None and mark.high is not None:
        yield _scatter(
            x=_positions(np.concatenate([mark.x, mark.x[::-1]])),
            y=np.concatenate([mark.high, mark.low[::-1]]).astype(np.float32),
            mode="lines",
            fill="toself",
            fillcolor=_transparent(colour, mark.opacity),
            line={"width": 0},
            hoverinfo="skip",
            showlegend=False,
        )
    if mark.y is not None:
        yield _scatter(
            x=_positions(mark.x),
            y=mark.y.astype(np.float32),
            mode="lines+markers" if mark.look.marker and mark.width >= 1.5 else "lines",
            line={"color": colour, "dash": _dash(mark.look), "width": mark.width},
            marker={"color": colour, "symbol": _SYMBOLS[mark.look.marker], "size": 5},
            **_hover(mark, "" if mark.name else "<extra></extra>"),
        )


@_traces_of.register
def _(mark: base.Scatter, panel: base.Panel) -> Iterator[Trace]:
    symbol = _SYMBOLS[mark.look.marker] + ("-open" if mark.hollow else "")
    marker: dict[str, Any] = {"symbol": symbol, "size": mark.size, "opacity": mark.opacity}
    if mark.edge:
        marker["line"] = {"color": mark.edge, "width": 0.5}
    if mark.values is not None and mark.colours is not None:
        values = np.asarray(mark.values, np.float64)
        marker |= {"color": values.tolist(), "cmin": mark.colours.low, "cmax": mark.colours.high}
        marker["colorscale"] = colour_scale(mark.colours.name)
    else:
        marker["color"] = mark.look.colour
    xs, ys = _rows(panel.x, mark.x), _rows(panel.y, mark.y)
    yield _scatter(x=xs, y=ys, mode="markers", marker=marker, **_hover(mark))


@_traces_of.register
def _(mark: base.Interval, panel: base.Panel) -> Iterator[Trace]:
    finite = bool(np.isfinite(mark.x))
    sides = {"array": mark.high - mark.x, "arrayminus": mark.x - mark.low}
    error = {side: [round(length, 2) if length > 0 else 0.0] * finite for side, length in sides.items()}
    style = {"color": mark.look.colour, "thickness": mark.width, "width": mark.cap}
    yield _scatter(
        x=[mark.x] * finite,
        y=_rows(panel.y, [mark.y] * finite),
        mode="markers",
        marker={"color": mark.look.colour, "symbol": _SYMBOLS[mark.look.marker], "size": mark.size},
        error_x={**error, **style},
        **_hover(mark),
    )


@_traces_of.register
def _(mark: base.Bar, _: base.Panel) -> Iterator[Trace]:
    shape = {"orientation": "h", "width": mark.height, "opacity": mark.opacity}
    yield {"type": "bar", "x": [mark.x], "y": [mark.y], **shape, "marker": {"color": mark.look.colour}}


@_traces_of.register
def _(mark: base.Heatmap, _: base.Panel) -> Iterator[Trace]:
    texts = [_shown(text) for text in mark.texts]
    columns, colours = len(mark.xs), mark.colours
    yield {
        "type": "heatmap",
        "x": mark.xs,
        "y": mark.ys,
        "z": [[None if np.isnan(value) else float(value) for value in row] for row in mark.values],
        "text": [texts[start : start + columns] for start in range(0, len(texts), columns)],
        "zmin": colours.low,
        "zmax": colours.high,
        "colorscale": colour_scale(colours.name),
        "showscale": False,
        "xgap": 1,
        "ygap": 1,
        "hovertemplate": _template(mark.hover, "z") + "<extra></extra>",
    }


@_traces_of.register
def _(mark: base.Polygons, _: base.Panel) -> Iterator[Trace]:
    xs = [x for outline in mark.outlines for x in (*_short(outline.xs), None)]  # None separates polygons
    ys = [y for outline in mark.outlines for y in (*_short(outline.ys), None)]
    line = {"color": mark.look.colour, "width": mark.width}
    fill = _transparent(mark.look.colour, mark.opacity)
    yield _scatter(x=xs, y=ys, mode="lines", line=line, fill="toself", fillcolor=fill, hoverinfo="skip")


@_traces_of.register
def _(mark: base.ReferenceLine, panel: base.Panel) -> Iterator[Trace]:
    # A trace with numbers would replace the names on an axis of teachers, so the layout draws the line there.
    if panel.y.kind is base.AxisKind.TEACHERS:
        return
    curves = [mark.x for mark in panel.marks if isinstance(mark, base.Curve) and len(mark.x)]
    ends = [min(x.min() for x in curves), max(x.max() for x in curves)] if curves else [0.0, 1.0]
    x, y = ([mark.x] * 2, ends) if mark.y is None else (_positions(np.array(ends)), [mark.y] * 2)
    line = {"color": mark.look.colour, "dash": _dash(mark.look), "width": mark.width}
    hover = "%{y:.0f}" if mark.x is None else "%{x:.0f}"
    yield _scatter(x=x, y=y, mode="lines", line=line, hovertemplate=hover)


@_traces_of.register
def _(mark: base.Label, _: base.Panel) -> Iterator[Trace]:
    position = "middle right" if mark.beside else "middle center"
    font = {"color": mark.look.colour, "size": 12}
    text = [_shown(mark.text)]
    yield _scatter(x=[mark.x], y=[mark.y], mode="text", text=text, textposition=position, textfont=font)


def _scatter(**entries: Any) -> Trace:
    return {"type": "scatter", **entries}


def _layout(chart: base.Chart, panel: base.Panel) -> dict[str, Any]:
    legend = chart.legend != base.Legend.NONE and any(mark.name for mark in panel.marks)
    layout: dict[str, Any] = {
        "height": chart.pixels,
        "font": {"family": FONT, "size": 12, "color": INK},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "margin": {"l": 54, "r": 14, "t": 34, "b": 46},
        "hoverlabel": {"font": {"family": FONT, "size": 12}},
        "modebar": {"bgcolor": "rgba(0,0,0,0)", "color": MUTED, "activecolor": INK},
        "uirevision": "kept",  # to keep the reader's zoom when the step changes
        "showlegend": legend,
        "xaxis": _axis(panel.x, panel),
        "yaxis": _axis(panel.y, panel) | ({"nticks": 4} if panel.subtitle else {}),
    }
    if panel.title:
        style = {"font": {"size": 13}, "x": 0.02, "xanchor": "left", "y": 0.95 if panel.subtitle else 0.97}
        layout["title"] = {"text": _heading(panel), **style}
    if panel.subtitle:
        layout["margin"] = {"l": 40, "r": 12, "t": 52, "b": 42}
    if legend:
        layout["legend"] = {"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom"}
        curves = all(isinstance(mark, base.Curve | base.ReferenceLine) for mark in panel.marks)
        layout |= {"hovermode": "x unified"} if curves else {}
    if panel.x.kind is base.AxisKind.STEPS:
        layout["meta"] = {"marks_step": True}
    rows = list(panel.y.rows)
    if panel.y.kind is base.AxisKind.TEACHERS:
        above = 14 + 20 * (bool(panel.title) + bool(panel.subtitle))
        frame = ROWS_FRAME + above
        layout["height"] = frame + ROW * len(rows)
        layout["margin"] = {"l": 20, "r": 14, "t": above, "b": 46}
        layout["meta"] = {"teachers": rows, "line_height": ROW, "frame_height": frame}
        shapes = [
            {"type": "line", "x0": mark.x, "x1": mark.x, "yref": "paper", "y0": 0, "y1": 1}
            | {"line": {"color": mark.look.colour, "dash": _dash(mark.look), "width": mark.width}}
            for mark in panel.marks
            if isinstance(mark, base.ReferenceLine)
        ]
        layout |= {"shapes": shapes} if shapes else {}
    if panel.y.kind is base.AxisKind.COMPARISONS:
        teachers = sorted({mark.teacher for mark in panel.marks if mark.teacher}, key=teacher_order)
        layout["height"] = COMPARISONS_FRAME + max(LEAST_HEIGHT, SPACING * (len(teachers) + 1)) * len(rows)
        layout["margin"] = {"l": 20, "r": 16, "t": 56, "b": 60}
        layout["legend"] = {"orientation": "h", "x": 0, "xanchor": "left", "y": -0.01, "yanchor": "top"}
        rule = {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "line": {"color": "#e6e8eb", "width": 1}}
        layout["shapes"] = [{**rule, "y0": y + 0.5, "y1": y + 0.5} for y in range(len(rows) - 1)]
        sizes = {"spacing": SPACING, "least_height": LEAST_HEIGHT, "frame_height": COMPARISONS_FRAME}
        layout["meta"] = {"rows": rows, "teachers": teachers, **sizes}
    return layout


def _axis(axis: base.PanelAxis, panel: base.Panel) -> dict[str, Any]:
    if not axis.shown:
        return {"visible": False}
    entries: dict[str, Any] = {
        "title": {"text": _shown(axis.title), "standoff": 8},
        "showgrid": axis.grid,
        "gridcolor": RULE,
        "linecolor": MUTED,
        "zeroline": False,
        "automargin": True,
    }
    entries |= {"range": [axis.low, axis.high]} if axis.bounded else {}
    entries |= {"dtick": 1} if axis.each_whole else {}
    names = [_shown(name) for name in axis.rows.values()]
    match axis.kind:
        case base.AxisKind.STEPS:
            entries |= {"rangemode": "tozero", "hoverformat": ",d"}
            entries |= {"nticks": 4} if panel.subtitle else {}
        case base.AxisKind.PERCENT if axis is panel.y:
            entries |= {"rangemode": "nonnegative"}
        case base.AxisKind.PERCENT:
            entries |= {"autorangeoptions": {"clipmin": -1, "clipmax": 101}}
            entries |= {"side": "top"} if panel.y.kind is base.AxisKind.COMPARISONS else {}
        case base.AxisKind.SHARE:
            entries |= {"tickformat": ".0%"}
        case base.AxisKind.TASK:
            name, bracket, unit = _shown(axis.title).partition(" (")
            title = f"{name}<br><span style='font-size:10px'>({unit}</span>" if bracket else name
            entries |= {"linecolor": RULE, "mirror": True, "title": {"text": title, "standoff": 6}}
        case base.AxisKind.TEACHERS:
            entries |= {"tickvals": names, "ticktext": names, "autorange": "reversed"}
        case base.AxisKind.NAMES | base.AxisKind.COMPARISONS:
            ends = [-0.5, len(names) - 0.5]
            entries |= {"tickvals": list(range(len(names))), "ticktext": names}
            entries |= {"range": ends[::-1], "ticklabelstandoff": 6} if axis is panel.y else {"range": ends}
    return entries


def _rows(axis: base.PanelAxis, positions: Any) -> Any:
    """Return `positions` as teachers' names on an axis of teachers, else as rounded numbers."""
    if axis.kind is base.AxisKind.TEACHERS:
        names = [_shown(name) for name in axis.rows.values()]
        return [names[int(position)] for position in positions]
    return _short(positions)


def _positions(steps: NDArray[Any]) -> NDArray[Any]:
    """Return steps as int64 if all are whole numbers, else as float32."""
    whole = np.equal(steps, np.round(steps)).all()
    return steps.astype(np.int64) if whole and len(steps) else steps.astype(np.float32)


def _short(values: Any) -> list[float]:
    """Return values rounded to four significant digits."""
    return [float(f"{value:.4g}") for value in values]


def _heading(panel: base.Panel) -> str:
    below = f"<br><span style='font-size:11px'>{_shown(panel.subtitle)}</span>" if panel.subtitle else ""
    return _shown(panel.title) + below


def _hover(mark: base.Mark, extra: str = "<extra></extra>") -> dict[str, Any]:
    if not mark.hover:
        return {"hoverinfo": "skip"}
    words = {"text": [_shown(text) for text in mark.texts]} if mark.texts else {}
    return words | {"hovertemplate": _template(mark.hover, "marker.color") + extra}


def _template(hover: str, value: str) -> str:
    """Convert a hover template to the syntax of plotly.js, with `value` as the field of a point's value."""
    return re.sub(r"\{(x|y|text)(:[^}]*)?\}", r"%{\1\2}", hover).replace("{value", f"%{{{value}")


def _dash(style: TeacherStyle) -> str:
    return "solid" if isinstance(style.dashes, str) else ",".join(f"{2 * part}px" for part in style.dashes[1])


def _transparent(colour: str, opacity: float) -> str:
    red, green, blue = (int(colour[start : start + 2], 16) for start in (1, 3, 5))
    return f"rgba({red},{green},{blue},{opacity:g})"


@cache
def colour_scale(name: str) -> list[list[Any]]:
    """Return a colour scale as defined by plotly.py, since plotly.js gives some names to other scales."""
    return [[position, colour] for position, colour in get_colorscale(name)]


@lru_cache(100_000)  # the same strings recur at every step
def _shown(text: str) -> str:
    """Escape the HTML in `text`, which plotly.js would otherwise interpret."""
    return html.escape(text, quote=False)


def _compact(value: Any) -> Any:
    """Return plain data in compact form: whole numbers as integers, arrays as bytes."""
    if isinstance(value, np.ndarray):
        if value.dtype == np.int64 and value.size and np.abs(value).max() <= np.iinfo(np.int32).max:
            value = value.astype(np.int32)
        kind = BINARY.get(str(value.dtype))
        if kind is None or not value.size:
            return _compact(value.tolist())
        return {"dtype": kind, "bdata": base64.b64encode(value.tobytes()).decode()}
    if isinstance(value, float):
        return int(value) if value.is_integer() else value
    if isinstance(value, Mapping):
        return {name: _compact(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return value if value and isinstance(value[0], str) else [_compact(entry) for entry in value]
    return value
