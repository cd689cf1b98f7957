"""Charts of pages as plotly has them, which refuses what plotly.js would ignore."""

from __future__ import annotations

import plotly.graph_objects as go

from analysis.charts.base import Chart
from analysis.charts.page import Plot, on_page


def plot_of(chart: Chart | None) -> Plot:
    """The plot of a chart that has a single one."""
    assert chart is not None
    (plot,) = on_page(chart).plots
    return plot


def figure_of(plot: Plot) -> go.Figure:
    """The figure of a plot, every attribute of it checked."""
    return go.Figure(list(plot.traces), plot.layout)
