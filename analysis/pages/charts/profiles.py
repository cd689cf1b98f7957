"""Performance profiles: the share of runs over each threshold, a line for each teacher."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from analysis.looks import look
from analysis.names import teacher_order
from analysis.pages.charts.chart import (
    Chart,
    Trace,
    axis,
    drawing_of,
    line,
    named,
    scatter,
    transparent,
)

HEIGHT = 330

FEWEST = 5
"""Runs under which the band of a line fills the panel, and is left out."""


def profile_chart(name: str, table: pd.DataFrame, quantity: str, title: str, caption: str) -> Chart:
    """Returns a chart with a line for each teacher, and a band where it has at least `FEWEST` runs.

    Args:
        name: of the chart.
        table: teacher, threshold, share, low, high and n, as of `aggregates.profiles`.
        quantity: label of the horizontal axis, on which thresholds are.
        title: what is shown.
        caption: of how many runs.
    """
    names = named(map(str, table["teacher"].unique()))
    traces = [
        trace
        for teacher in sorted(names, key=teacher_order)
        for trace in _traces(teacher, names[teacher], table[table["teacher"] == teacher])
    ]
    layout = {
        "xaxis": axis(quantity, range=[0, 100], showgrid=False),
        "yaxis": axis("Runs over it (%)", range=[-2, 102]),
        "hovermode": "x unified",
        "showlegend": True,
        "legend": {"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom"},
    }
    return Chart(name, title, caption, drawing_of(traces, HEIGHT, layout, ()))


def _traces(teacher: str, name: str, rows: pd.DataFrame) -> Iterator[Trace]:
    rows = rows.sort_values("threshold")
    thresholds = rows["threshold"].to_numpy(np.float32)
    share, low, high = (100 * rows[column].to_numpy(np.float32) for column in ("share", "low", "high"))
    whose = {"name": name, "legendgroup": teacher, "meta": {"teacher": teacher}}
    if rows["n"].min() >= FEWEST:
        yield scatter(
            x=np.concatenate([thresholds, thresholds[::-1]]),
            y=np.concatenate([high, low[::-1]]),
            mode="lines",
            fill="toself",
            fillcolor=transparent(look(teacher).colour, 0.1),
            line={"width": 0},
            hoverinfo="skip",
            showlegend=False,
            **whose,
        )
    yield scatter(
        x=thresholds,
        y=share,
        mode="lines",
        line=line(teacher),
        customdata=np.column_stack([low, high]).round().tolist(),
        hovertemplate="%{y:.0f} % [%{customdata[0]}, %{customdata[1]}]",
        **whose,
    )
