"""Figures that teachers log of themselves, such as losses, over the steps of a run: a chart for each."""

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
    named,
    scatter,
    shown,
    transparent,
)

HEIGHT = 230
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
            drawing = drawing_of(_traces(teacher, values), HEIGHT, layout, ())
            yield Chart(f"{prefix}-{teacher}-{number}", "Teachers' logs", caption, drawing, teacher)


def hidden_scalars(curricula: Mapping[str, Curriculum]) -> int:
    """Returns how many scalars are not drawn."""
    return sum(max(0, len(scalars_of(each)) - MOST_PER_TEACHER) for each in curricula.values())


def _whole(values: pd.Series) -> dict[str, Any]:
    """Returns what keeps ticks between two whole numbers from an axis of nothing but whole numbers."""
    few = values.max() - values.min() < 5  # of more, plotly's own ticks are whole
    return {"dtick": 1} if few and (values % 1 == 0).all() else {}


def _traces(teacher: str, values: pd.Series) -> list[Trace]:
    hover = "%{y:.4g} at step %{x:,d}<extra></extra>"
    whose = {"meta": {"teacher": teacher}, "showlegend": False}
    look_of = line(teacher, width=1.5, dash="solid")
    if len(values) <= BINS:
        steps, shown_values = values.index.to_numpy(), _short(values)
        return [scatter(x=steps, y=shown_values, mode="lines", line=look_of, hovertemplate=hover, **whose)]
    part = np.arange(len(values)) * BINS // len(values)
    binned = pd.DataFrame({"step": values.index, "value": values.to_numpy()}).groupby(part)
    steps = binned["step"].median().to_numpy()
    low, median, high = (_short(binned["value"].agg(name)) for name in ("min", "median", "max"))
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


def _short(values: pd.Series) -> np.ndarray:
    return values.to_numpy(np.float32)
