"""Every seed of every teacher, with the mean and its interval, at any step."""

from __future__ import annotations

import math
from typing import Any

import pandas as pd

from analysis.formatting import number
from analysis.looks import look
from analysis.names import teacher_order
from analysis.pages.charts.chart import (
    END,
    Chart,
    Trace,
    axis,
    bounds_of,
    drawing_of,
    marker,
    named,
    reaches,
    scatter,
    step_frame,
)
from analysis.statistics import describe, mean_percent_interval

ROW = 34
"""Height of a teacher's row, CSS pixels."""

FRAME = 90
"""Height of axis and margins, CSS pixels."""


def seeds_chart(name: str, points: pd.DataFrame, quantity: str, title: str, caption: str) -> Chart:
    """Returns a chart with a row for each teacher: seeds as dots, their mean with its 95 % interval.

    Args:
        name: of the chart.
        points: teacher, seed, step (of an evaluation, or `END`) and value, in per cent.
        quantity: label of the horizontal axis.
        title: what is shown.
        caption: of how many seeds.
    """
    teachers = sorted(map(str, points["teacher"].unique()), key=teacher_order)
    ends, names = points[points["step"] == END], named(teachers)
    traces = [trace for teacher in teachers for trace in _traces(teacher, names[teacher], ends)]
    frames = []
    for step, rows in points.groupby("step", sort=False):
        changed = [patch for teacher in teachers for patch in _patches(teacher, names[teacher], rows)]
        frames.append(step_frame(step, dict(enumerate(changed))))
    ticks: dict[str, Any] = {
        "tickvals": [names[each] for each in teachers],
        "ticktext": [names[each] for each in teachers],
    }
    layout = {
        "xaxis": axis(quantity, **bounds_of(quantity)),
        "yaxis": axis(autorange="reversed", showgrid=False, **ticks),
        "margin": {"l": 20, "r": 14, "t": 14, "b": 46},
        "meta": {"teachers": teachers, "line_height": ROW, "frame_height": FRAME},
    }
    return Chart(name, title, caption, drawing_of(traces, FRAME + ROW * len(teachers), layout, frames))


def _traces(teacher: str, name: str, ends: pd.DataFrame) -> list[Trace]:
    dots, mean = _patches(teacher, name, ends)
    whose = {"meta": {"teacher": teacher}, "mode": "markers"}
    faint = marker(teacher, symbol="circle-open", size=8, opacity=0.75)
    error = {**mean.pop("error_x"), "color": look(teacher).colour, "thickness": 2, "width": 5}
    return [
        scatter(**dots, **whose, name="", marker=faint),
        scatter(**mean, **whose, name="", marker=marker(teacher, size=11), error_x=error),
    ]


def _patches(teacher: str, name: str, rows: pd.DataFrame) -> list[dict[str, Any]]:
    """Returns what changes with the step: the dots of a teacher, and its mean."""
    mine = rows[(rows["teacher"] == teacher) & rows["value"].notna()]
    dots = {
        "x": [round(float(value), 2) for value in mine["value"]],
        "y": [name] * len(mine),
        "hovertemplate": [f"{name}, seed {seed}: %{{x:.1f}}" for seed in mine["seed"]],
    }
    if mine.empty:
        return [dots, {"x": [], "y": [], "hovertemplate": "", "error_x": {"array": [], "arrayminus": []}}]
    sample = describe(mine["value"])
    low, high = mean_percent_interval(sample)
    interval = f"<br>95 % interval {number(low)} to {number(high)}" if math.isfinite(low) else ""
    mean = {
        "x": [round(sample.mean, 2)],
        "y": [name],
        "hovertemplate": f"{name}: mean {number(sample.mean)} of {sample.n}{interval}",
        "error_x": reaches(sample.mean, low, high),
    }
    return [dots, mean]
