"""What readers see: charts of pages as plotly has them, and what commands print."""

from __future__ import annotations

import base64
import gzip
import re
from collections.abc import Callable

import plotly.graph_objects as go
from rich.console import Console

from analysis.charts.base import Chart
from analysis.charts.page import Plot, on_page

Told = Callable[..., str]
"""Runs a command of these words that must end with this exit code, and gives what it says."""


def plot_of(chart: Chart | None) -> Plot:
    """The plot of a chart that has a single one."""
    assert chart is not None
    (plot,) = on_page(chart).plots
    return plot


def figure_of(plot: Plot) -> go.Figure:
    """The figure of a plot, every attribute of it checked, which refuses what plotly.js would ignore."""
    return go.Figure(list(plot.traces), plot.layout)


def printed(show: Callable[..., object], *given: object, width: int = 200, **options: object) -> str:
    """What a command prints on lines of so many characters."""
    console = Console(width=width, record=True)
    show(*given, **options, console=console)
    return console.export_text()


def unpacked(page: str) -> str:
    """A page with the scripts and charts in it that its reader's browser unpacks."""
    script = r'(<script type="application/gzip"[^>]*>)([^<]*)</script>'
    return re.sub(
        script,
        lambda found: f"{found[1]}{gzip.decompress(base64.b64decode(found[2])).decode()}</script>",
        page,
    )


def addresses_in(page: str) -> set[str]:
    """The addresses of the network in the scripts and attributes of a page, but for names of markup."""
    strings = re.findall(r"""["'`]\s*(https?://[^"'`]*)""", page)
    return {text for text in strings if not text.startswith("http://www.w3.org/")}
