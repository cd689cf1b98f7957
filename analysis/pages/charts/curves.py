"""Learning curves: mean and standard error over seeds, against steps."""

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
    marker,
    named,
    scatter,
    transparent,
)

HEIGHT = 330

MARKED = 45
"""Lines with more points have no marks."""


def curve_chart(name: str, table: pd.DataFrame, quantity: str, title: str, caption: str) -> Chart:
    """Returns a chart with a line and a band for each teacher.

    Args:
        name: of the chart.
        table: teacher, step, n, mean and standard_error, as of `measures.aggregate`.
        quantity: label of the vertical axis.
        title: what is shown.
        caption: of how many seeds.
    """
    mode = "lines+markers" if table.groupby("teacher")["step"].size().max() <= MARKED else "lines"
    names = named(map(str, table["teacher"].unique()))
    teachers = sorted(names, key=teacher_order)
    traces = [trace for teacher in teachers for trace in _traces(teacher, names[teacher], table, mode)]
    layout = {
        "xaxis": axis("Environment steps", rangemode="tozero", hoverformat=",d", showgrid=False),
        "yaxis": axis(quantity, **_from_zero(table)),
        "hovermode": "x unified",
        "showlegend": True,
        "legend": {"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom"},
        "meta": {"marks_step": True},
    }
    return Chart(name, title, caption, drawing_of(traces, HEIGHT, layout, ()))


def _from_zero(table: pd.DataFrame) -> dict[str, str]:
    """Returns what keeps an axis of nothing but zeros, as of mastered tasks at first, from reaching below."""
    lowest = (table["mean"] - table["standard_error"].fillna(0)).min()
    return {"rangemode": "nonnegative"} if lowest >= 0 else {}


def _traces(teacher: str, name: str, table: pd.DataFrame, mode: str) -> Iterator[Trace]:
    rows = table[(table["teacher"] == teacher) & table["mean"].notna()].sort_values("step")
    steps, mean = rows["step"].to_numpy(np.int64), rows["mean"].to_numpy(np.float64)
    error = rows["standard_error"].fillna(0).to_numpy(np.float64)
    whose = {"name": name, "legendgroup": teacher, "meta": {"teacher": teacher}}
    yield scatter(
        x=np.concatenate([steps, steps[::-1]]),
        y=_short(np.concatenate([mean + error, (mean - error)[::-1]])),
        mode="lines",
        fill="toself",
        fillcolor=transparent(look(teacher).colour, 0.16),
        line={"width": 0},
        hoverinfo="skip",
        showlegend=False,
        **whose,
    )
    yield scatter(
        x=steps,
        y=_short(mean),
        mode=mode,
        line=line(teacher),
        marker=marker(teacher, size=5),
        customdata=[[f"{e:.1f}", int(n)] for e, n in zip(error, rows["n"], strict=True)],
        hovertemplate="%{y:.1f} ± %{customdata[0]}, n = %{customdata[1]}",
        **whose,
    )


def _short(values: np.ndarray) -> np.ndarray:
    """Returns values as plotly embeds them in half the room."""
    return values.astype(np.float32)
