"""Charts of pages as plotly has them, which refuses what plotly.js would ignore."""

from __future__ import annotations

import plotly.graph_objects as go

from analysis.pages.charts import Chart


def figure_of(chart: Chart) -> go.Figure:
    """The figure of a chart, every attribute of it checked."""
    return go.Figure(list(chart.drawing.traces), chart.drawing.layout)
