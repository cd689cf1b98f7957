"""Lines with bands: learning curves, performance profiles, and the scalars that teachers log."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd

from analysis.data.curricula import Curriculum
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
    shown,
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


PROFILE_HEIGHT = 330

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
        for trace in _profile_traces(teacher, names[teacher], table[table["teacher"] == teacher])
    ]
    layout = {
        "xaxis": axis(quantity, range=[0, 100], showgrid=False),
        "yaxis": axis("Runs over it (%)", range=[-2, 102]),
        "hovermode": "x unified",
        "showlegend": True,
        "legend": {"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom"},
    }
    return Chart(name, title, caption, drawing_of(traces, PROFILE_HEIGHT, layout, ()))


def _profile_traces(teacher: str, name: str, rows: pd.DataFrame) -> Iterator[Trace]:
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


SCALAR_HEIGHT = 230
"""CSS pixels."""

MOST_PER_TEACHER = 8
"""Scalars of one teacher that are drawn, in the order of their names."""

BINS = 150
"""A longer series is drawn as the median of so many equal parts, within its range in each."""


def scalars_of(curriculum: Curriculum) -> dict[str, pd.Series]:
    """Returns the finite values of every scalar by its name, indexed by step."""
    rows = [
        (int(step), str(name), float(value))
        for step, scalars in zip(curriculum.updates["step"], curriculum.updates["scalars"], strict=True)
        for name, value in (scalars or ())
        if math.isfinite(value)
    ]
    table = pd.DataFrame(rows, columns=["step", "name", "value"])
    return {str(name): rows.set_index("step")["value"] for name, rows in table.groupby("name")}


def scalar_charts(prefix: str, curricula: Mapping[str, Curriculum], caption: str) -> Iterator[Chart]:
    """Yields a chart for each scalar that a teacher logs, at most `MOST_PER_TEACHER` of a teacher.

    Args:
        prefix: of the charts' names.
        curricula: one run for each teacher.
        caption: which runs they are.
    """
    names = named(curricula)
    for teacher in sorted(curricula, key=teacher_order):
        series = list(scalars_of(curricula[teacher]).items())[:MOST_PER_TEACHER]
        for number, (scalar, values) in enumerate(series, start=1):
            text = (
                f"{names[teacher]}<br><span style='font-size:11px'>{shown(scalar.replace('_', ' '))}</span>"
            )
            layout = {
                "title": {"text": text, "font": {"size": 13}, "x": 0.02, "xanchor": "left", "y": 0.95},
                "xaxis": axis(
                    "Environment steps", rangemode="tozero", hoverformat=",d", showgrid=False, nticks=4
                ),
                "yaxis": axis(**_whole(values)),
                "margin": {"l": 40, "r": 12, "t": 52, "b": 42},
                "meta": {"marks_step": True},
            }
            drawing = drawing_of(_scalar_traces(teacher, values), SCALAR_HEIGHT, layout, ())
            yield Chart(f"{prefix}-{teacher}-{number}", "Teachers' logs", caption, drawing, teacher)


def hidden_scalars(curricula: Mapping[str, Curriculum]) -> int:
    """Returns how many scalars are not drawn."""
    return sum(max(0, len(scalars_of(each)) - MOST_PER_TEACHER) for each in curricula.values())


def _whole(values: pd.Series) -> dict[str, Any]:
    """Returns what keeps ticks between two whole numbers from an axis of nothing but whole numbers."""
    few = values.max() - values.min() < 5  # of more, plotly's own ticks are whole
    return {"dtick": 1} if few and (values % 1 == 0).all() else {}


def _scalar_traces(teacher: str, values: pd.Series) -> list[Trace]:
    hover = "%{y:.4g} at step %{x:,d}<extra></extra>"
    whose = {"meta": {"teacher": teacher}, "showlegend": False}
    look_of = line(teacher, width=1.5, dash="solid")
    if len(values) <= BINS:
        steps, shown_values = values.index.to_numpy(), values.to_numpy(np.float32)
        return [scatter(x=steps, y=shown_values, mode="lines", line=look_of, hovertemplate=hover, **whose)]
    part = np.arange(len(values)) * BINS // len(values)
    binned = pd.DataFrame({"step": values.index, "value": values.to_numpy()}).groupby(part)
    steps = binned["step"].median().to_numpy()
    low, median, high = (binned["value"].agg(name).to_numpy(np.float32) for name in ("min", "median", "max"))
    band = scatter(
        x=np.concatenate([steps, steps[::-1]]),
        y=np.concatenate([high, low[::-1]]),
        mode="lines",
        fill="toself",
        fillcolor=transparent(look(teacher).colour, 0.2),
        line={"width": 0},
        hoverinfo="skip",
        **whose,
    )
    return [band, scatter(x=steps, y=median, mode="lines", line=look_of, hovertemplate=hover, **whose)]
