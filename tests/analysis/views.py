"""Output for readers: charts of pages as plotly figures, and texts of commands."""

import base64
import gzip
import re
from collections.abc import Callable

import plotly.graph_objects as go
from rich.console import Console

from analysis.charts.base import Chart
from analysis.charts.page import Plot, on_page

Told = Callable[..., str]
"""Function that runs a command with an expected exit code, and returns its output."""


def plot_of(chart: Chart | None) -> Plot:
    assert chart is not None
    (plot,) = on_page(chart).plots
    return plot


def figure_of(plot: Plot) -> go.Figure:
    """Return the plotly figure of a plot, which validates all attributes."""
    return go.Figure(list(plot.traces), plot.layout)


def printed(show: Callable[..., object], *given: object, width: int = 200, **options: object) -> str:
    console = Console(width=width, record=True)
    show(*given, **options, console=console)
    return console.export_text()


def unpacked(page: str) -> str:
    script = r'(<script type="application/gzip"[^>]*>)([^<]*)</script>'
    plain = lambda found: gzip.decompress(base64.b64decode(found[2])).decode()  # noqa: E731
    return re.sub(script, lambda found: f"{found[1]}{plain(found)}</script>", page)


def addresses_in(page: str) -> set[str]:
    """Return the network addresses in scripts and attributes of a page, except XML namespaces."""
    strings = re.findall(r"""["'`]\s*(https?://[^"'`]*)""", page)
    return {text for text in strings if not text.startswith("http://www.w3.org/")}
