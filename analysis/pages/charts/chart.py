"""Elements that all charts share: look, step shown, and names of traces."""

from __future__ import annotations

import base64
import html
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from plotly.colors import get_colorscale
from plotly.io.json import to_json_plotly
from plotly.offline import get_plotlyjs

from analysis.data.curricula import Axis
from analysis.looks import INK, MUTED, RULE, look
from analysis.names import short_labels

LONGEST = 30
"""Characters of a teacher's name in a chart."""

END = "end"
"""Frame of a chart that shows the ends of runs; other frames are named by their step."""

FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"

_ADDRESS = re.compile(r"""(["'`])https?://(?!www\.w3\.org/)[^"'`]*\1""")
"""A string of a program that is nothing but an address, other than that of a namespace of XML."""

_SYMBOLS = {
    "o": "circle",
    "s": "square",
    "D": "diamond",
    "^": "triangle-up",
    "v": "triangle-down",
    "P": "cross",
    "X": "x",
    "p": "pentagon",
    "h": "hexagon",
    "<": "triangle-left",
    ">": "triangle-right",
    "*": "star",
    "d": "diamond-tall",
}
"""Markers of `style.look` as plotly calls them."""


Trace: TypeAlias = dict[str, Any]
"""A series of marks, a line or a map, as plotly.js has it."""

BINARY = {"float32": "f4", "float64": "f8", "int32": "i4"}
"""Arrays that are embedded as bytes, and what plotly.js calls their types."""


@dataclass(frozen=True, eq=False)
class Drawing:
    """A figure of plotly.js, and what changes of it with the step.

    It is plain data: plotly's own classes would take half of a page's time to check it.

    Attributes:
        traces: of `scatter` and `heatmap`.
        layout: axes, margins, legend.
        frames: of `step_frame`.
    """

    traces: tuple[Trace, ...]
    layout: dict[str, Any]
    frames: tuple[dict[str, Any], ...]

    @property
    def json(self) -> str:
        """All of it as JSON, which plotly.js reads."""
        whole = {"data": list(self.traces), "layout": self.layout, "frames": list(self.frames)}
        return str(to_json_plotly(_compact(whole)))


@dataclass(frozen=True, eq=False)
class Chart:
    """A chart of a page.

    Traces say in ``meta`` whose they are (teacher, comparison), so that the page can hide them; ``frames``
    hold what changes with the step.

    Attributes:
        name: identifier on the page, and name of the picture a reader saves.
        title: what it is, in a few words.
        caption: what is shown, of how many seeds.
        drawing: what it shows.
        teacher: whose chart it is, if it shows a single one.
    """

    name: str
    title: str
    caption: str
    drawing: Drawing
    teacher: str = ""

    @property
    def height(self) -> int:
        """CSS pixels."""
        return int(self.drawing.layout["height"])

    @property
    def json(self) -> str:
        """The figure as JSON that may stand in a script element of a page."""
        return self.drawing.json.replace("<", "\\u003c")


def plotly_library() -> str:
    """Returns plotly.js, as it may stand in a script element, without addresses to send to or load from."""
    return _ADDRESS.sub(r"\1\1", str(get_plotlyjs())).replace("</script", "<\\/script")


def drawing_of(
    traces: Iterable[Trace], height: int, layout: Mapping[str, Any], frames: Iterable[dict[str, Any]]
) -> Drawing:
    """Returns a drawing in the look of the house.

    Args:
        traces: of `scatter` and `heatmap`.
        height: CSS pixels.
        layout: what this chart has of its own.
        frames: of `step_frame`.
    """
    shared = {
        "height": height,
        "font": {"family": FONT, "size": 12, "color": INK},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "margin": {"l": 54, "r": 14, "t": 34, "b": 46},
        "hoverlabel": {"font": {"family": FONT, "size": 12}},
        "modebar": {"bgcolor": "rgba(0,0,0,0)", "color": MUTED, "activecolor": INK},
        "uirevision": "kept",  # a reader's zoom outlives a change of step
        "showlegend": False,
    }
    return Drawing(tuple(traces), {**shared, **layout}, tuple(frames))


def scatter(**own: Any) -> Trace:
    """Returns a trace of marks or of a line."""
    return {"type": "scatter", **own}


def heatmap(**own: Any) -> Trace:
    """Returns a trace that colours the cells of a grid."""
    return {"type": "heatmap", **own}


def scale(name: str) -> list[list[Any]]:
    """Returns a colour scale by its name in Python: of the same names plotly.js has other scales."""
    return [[place, colour] for place, colour in get_colorscale(name)]


def axis(title: str = "", **own: Any) -> dict[str, Any]:
    """Returns an axis in the look of the house, with what it has of its own."""
    quiet = {"gridcolor": RULE, "linecolor": MUTED, "zeroline": False, "automargin": True}
    return {"title": {"text": shown(title), "standoff": 8}, **quiet, **own}


def task_axis(dimension: Axis) -> dict[str, Any]:
    """Returns the axis of a task dimension in a small chart: its unit stands on a line of its own."""
    name, bracket, unit = shown(dimension.name).partition(" (")
    title = f"{name}<br><span style='font-size:10px'>({unit}</span>" if bracket else name
    return axis(showgrid=False, linecolor=RULE, mirror=True) | {"title": {"text": title, "standoff": 6}}


def bounds_of(quantity: str) -> dict[str, Any]:
    """Returns what an axis may show: per cent end at 0 and 100, with room for marks there."""
    return {"autorangeoptions": {"clipmin": -1, "clipmax": 101}} if "%" in quantity else {}


def reaches(mean: float, low: float, high: float) -> dict[str, list[float]]:
    """Returns the lengths of both sides of an interval around a mean as plotly has them; 0 if NaN."""
    sides = {"array": high - mean, "arrayminus": mean - low}
    return {side: [round(length, 2) if length > 0 else 0.0] for side, length in sides.items()}


def step_frame(step: object, traces: Mapping[int, Mapping[str, Any]], title: str = "") -> dict[str, Any]:
    """Returns what a chart shows at `step`: of each trace, by its place, what changes."""
    frame = {"name": str(step), "traces": list(traces), "data": [dict(patch) for patch in traces.values()]}
    return frame | ({"layout": {"title": {"text": title}}} if title else {})


def _compact(value: Any) -> Any:
    """Returns plain data that takes little room: whole numbers as integers, arrays of numbers as bytes."""
    if isinstance(value, np.ndarray):
        return _binary(value)
    if isinstance(value, float):
        return int(value) if value.is_integer() else value
    if isinstance(value, dict):
        return {name: _compact(each) for name, each in value.items()}
    return [_compact(each) for each in value] if isinstance(value, list) else value


def _binary(values: NDArray[Any]) -> Any:
    """Returns numbers (n,) as plotly.js reads them from bytes; other values as a list."""
    if values.dtype == np.int64 and values.size and np.abs(values).max() <= np.iinfo(np.int32).max:
        values = values.astype(np.int32)
    kind = BINARY.get(str(values.dtype))
    if kind is None or not values.size:
        return _compact(values.tolist())
    return {"dtype": kind, "bdata": base64.b64encode(values.tobytes()).decode()}


def marker(teacher: str, **own: Any) -> dict[str, Any]:
    """Returns the marker of a teacher."""
    style = look(teacher)
    return {"color": style.colour, "symbol": _SYMBOLS[style.marker], **own}


def line(teacher: str, **own: Any) -> dict[str, Any]:
    """Returns the line of a teacher."""
    style = look(teacher)
    dash = "solid" if isinstance(style.dashes, str) else ",".join(f"{2 * part}px" for part in style.dashes[1])
    return {"color": style.colour, "dash": dash, "width": 2, **own}


def transparent(colour: str, opacity: float) -> str:
    """Returns ``#rrggbb`` as a colour that lets `1 - opacity` of the page through."""
    red, green, blue = (int(colour[place : place + 2], 16) for place in (1, 3, 5))
    return f"rgba({red},{green},{blue},{opacity:g})"


def named(teachers: Iterable[str]) -> dict[str, str]:
    """Returns short labels of all teachers of a chart as its text, by teacher."""
    return {teacher: shown(name) for teacher, name in short_labels(teachers, LONGEST).items()}


def shown(text: str) -> str:
    """Returns `text` so that plotly shows it as it is: it takes some HTML for its own."""
    return html.escape(text, quote=False)
