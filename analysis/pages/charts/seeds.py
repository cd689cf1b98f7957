"""Means with 95 % intervals: run by run of one comparison, and all comparisons of a page at once."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from analysis.formatting import number
from analysis.looks import look
from analysis.names import mark_of, teacher_order
from analysis.pages.charts.chart import (
    END,
    Chart,
    Drawing,
    Trace,
    axis,
    bounds_of,
    drawing_of,
    marker,
    named,
    reaches,
    scatter,
    shown,
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


SPACING, LEAST = 11, 30
"""Height of a mean and at least of a row, CSS pixels."""

OVERVIEW_FRAME = 130
"""Height of axis and legend, CSS pixels."""

NOTHING: dict[str, Any] = {"x": [], "y": [], "hovertemplate": "", "error_x": {"array": [], "arrayminus": []}}
"""A trace without its mean."""


def overview_chart(
    points: pd.DataFrame, rows: Mapping[str, str], quantity: str, title: str, caption: str
) -> Chart:
    """Returns a chart with a row for each comparison and in it the mean of each teacher.

    Every pair of comparison and teacher is a trace, so that the page can leave out either; it moves rows and
    means together then, by ``rows`` (anchors) and ``teachers`` in the meta of the layout.

    Args:
        points: comparison (its anchor), teacher, step (of an evaluation, or `charts.END`) and value of a run,
            in per cent.
        rows: title of each comparison by its anchor, in order.
        quantity: label of the horizontal axis.
        title: what is shown.
        caption: of how many seeds.
    """
    teachers = sorted(map(str, points["teacher"].unique()), key=teacher_order)
    offsets = dict(zip(teachers, np.linspace(-0.33, 0.33, len(teachers) + 2)[1:-1], strict=True))
    order = {anchor: place for place, anchor in enumerate(rows)}
    pairs = list(points[["comparison", "teacher"]].drop_duplicates().itertuples(index=False, name=None))
    pairs.sort(key=lambda pair: (order[pair[0]], teacher_order(pair[1])))
    places = {pair: order[pair[0]] + float(offsets[pair[1]]) for pair in pairs}
    patches = {
        step: _step_patches(group, places) for step, group in points.groupby("step", sort=False, dropna=False)
    }
    names = named(teachers)
    ends, seen = patches.get(END, {}), set[str]()
    traces = []
    for index, (anchor, teacher) in enumerate(pairs):
        traces.append(_trace(anchor, teacher, names[teacher], ends.get(index, NOTHING), teacher not in seen))
        seen.add(teacher)
    frames = [step_frame(step, changed) for step, changed in patches.items()]
    return Chart("overview", title, caption, _figure(traces, frames, rows, teachers, quantity))


def _step_patches(group: pd.DataFrame, places: Mapping[tuple[str, str], float]) -> dict[int, dict[str, Any]]:
    """Returns what a step changes of each trace, by its place; nothing of comparisons without it."""
    names = named(teacher for _, teacher in places)
    samples = dict(list(group.groupby(["comparison", "teacher"])["value"]))
    there = set(group["comparison"])
    return {
        index: _patch(names[pair[1]], samples[pair], place) if pair in samples else NOTHING
        for index, (pair, place) in enumerate(places.items())
        if pair[0] in there
    }


def _figure(
    traces: list[Trace],
    frames: list[dict[str, Any]],
    rows: Mapping[str, str],
    teachers: list[str],
    quantity: str,
) -> Drawing:
    row = max(LEAST, SPACING * (len(teachers) + 1))
    places = list(range(len(rows)))
    names = [shown(text) for text in rows.values()]
    ticks: dict[str, Any] = {"tickvals": places, "ticktext": names, "ticklabelstandoff": 6}
    layout = {
        "xaxis": axis(quantity, side="top", **bounds_of(quantity)),
        "yaxis": axis(range=[len(rows) - 0.5, -0.5], showgrid=False, **ticks),
        "shapes": [_rule(place + 0.5) for place in places[:-1]],
        "showlegend": True,
        "legend": {"orientation": "h", "x": 0, "xanchor": "left", "y": -0.01, "yanchor": "top"},
        "margin": {"l": 20, "r": 16, "t": 56, "b": 60},
        "meta": {
            "rows": list(rows),
            "teachers": teachers,
            "spacing": SPACING,
            "least_height": LEAST,
            "frame_height": OVERVIEW_FRAME,
        },
    }
    return drawing_of(traces, OVERVIEW_FRAME + row * len(rows), layout, frames)


def _rule(place: float) -> dict[str, Any]:
    return {
        "type": "line",
        "xref": "paper",
        "x0": 0,
        "x1": 1,
        "y0": place,
        "y1": place,
        "line": {"color": "#e6e8eb", "width": 1},
    }


def _trace(anchor: str, teacher: str, name: str, end: Mapping[str, Any], first: bool) -> Trace:
    style = {"color": look(teacher).colour, "thickness": 1.6, "width": 0}
    return scatter(
        **{**end, "error_x": {**end["error_x"], **style}},
        mode="markers",
        name=name,
        legendgroup=teacher,
        legendrank=999 if mark_of(teacher) else 1000,  # a reader's own is first, whatever it lacks
        showlegend=first,
        marker=marker(teacher, size=8),
        meta={"teacher": teacher, "comparison": anchor},
    )


def _patch(name: str, values: pd.Series, place: float) -> dict[str, Any]:
    sample = describe(values)
    if not sample.n:
        return NOTHING
    low, high = mean_percent_interval(sample)
    interval = f", 95 % interval {number(low)} to {number(high)}" if math.isfinite(low) else ""
    text = f"{name}: {number(sample.mean)}{interval}, n = {sample.n}<extra></extra>"
    return {
        "x": [round(sample.mean, 2)],
        "y": [round(place, 3)],
        "hovertemplate": text,
        "error_x": reaches(sample.mean, low, high),
    }
