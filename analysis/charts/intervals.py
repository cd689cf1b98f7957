"""Means with intervals: run by run, all comparisons at once, ranks."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from analysis.charts import base
from analysis.comparisons.against_random import AgainstRandom
from analysis.comparisons.ranks import Rank
from analysis.comparisons.verdicts import AXES
from analysis.formatting import number
from analysis.looks import look
from analysis.measures.tested import FINAL, HEADLINE, TRAINED
from analysis.names import short_labels
from analysis.statistics import describe, mean_percent_interval


def seeds_chart(points: pd.DataFrame, quantity: str, name: str, heading: str, caption: str) -> base.Chart:
    """Return a row for each teacher: its runs as rings, their mean with its 95 % interval.

    Args:
        points: teacher, seed, step (of an evaluation, or `END`) and value, in per cent.
        quantity: title of the horizontal axis.
        name: identifier of the chart.
        heading: title of the chart.
        caption: content and number of runs.
    """
    rows = short_labels(map(str, points["teacher"].unique()), base.LONGEST_NAME)
    axes = base.Scale(quantity, base.Kind.PERCENT, grid=True), base.Scale(kind=base.Kind.TEACHERS, rows=rows)
    known = points[points["value"].notna()]
    places = known.groupby(["step", "teacher"], sort=False).indices
    values, seeds = known["value"].to_numpy(float), known["seed"].to_numpy(object)

    def at(step: Any) -> base.Panel:
        marks = list[base.Mark]()
        for place, (teacher, label) in enumerate(rows.items()):
            mine = places.get((step, teacher), [])
            marks.append(
                base.Dots(
                    x=[round(value, 2) for value in values[mine].tolist()],
                    y=[place] * len(mine),
                    words=[f"{label}, seed {seed}" for seed in seeds[mine]],
                    hover="{text}: {x:.1f}",
                    look=look(teacher)._replace(marker="o"),
                    teacher=teacher,
                    size=8.0,
                    hollow=True,
                    opacity=0.75,
                )
            )
            words, style = f"{label}: mean {{}} of {{}}", {"size": 11.0, "width": 2.0, "cap": 5.0}
            marks.append(_mean(values[mine], teacher, place, words, **style))
        return base.Panel(*axes, marks)

    return _moving(name, at, list(dict.fromkeys(points["step"])), heading, caption, len(rows))


def _mean(values: base.Array, teacher: str, place: float, words: str, **own: Any) -> base.Interval:
    """Return the mean of values with its 95 % interval, and both in words with the number of runs."""
    sample = describe(values)
    low, high = mean_percent_interval(sample) if sample.n else (math.nan, math.nan)
    text = words.format(number(sample.mean), sample.n) if sample.n else ""
    if math.isfinite(low):
        text += f", 95 % interval {number(low)} to {number(high)}"
    return base.Interval(
        x=round(sample.mean, 2) if sample.n else math.nan,
        y=round(place, 3),
        low=low,
        high=high,
        words=[text],
        hover="{text}",
        look=look(teacher),
        teacher=teacher,
        **own,
    )


def _moving(
    name: str, at: Any, moments: Sequence[object], heading: str, caption: str, rows: int
) -> base.Chart:
    """Return a chart of one panel that shows the ends of runs, or any of its moments."""
    return base.Chart(
        name, [[base.moving(at, moments, base.END)]], heading, caption, size=(5.2, 0.9 + 0.42 * rows)
    )


def overview_chart(
    points: pd.DataFrame, rows: Mapping[str, str], quantity: str, heading: str, caption: str
) -> base.Chart:
    """Return a row for each comparison, and in it the mean of each teacher with its 95 % interval.

    Every pair of comparison and teacher is a mark, so that a page can leave out either.

    Args:
        points: comparison (its anchor), teacher, step (of an evaluation, or `END`) and value of a run, in per
            cent.
        rows: title of each comparison by its anchor, in order.
        quantity: title of the horizontal axis.
        heading: title of the chart.
        caption: content and number of runs.
    """
    names = short_labels(map(str, points["teacher"].unique()), base.LONGEST_NAME)
    offsets = dict(zip(names, np.linspace(-0.33, 0.33, len(names) + 2)[1:-1], strict=True))
    order = {anchor: place for place, anchor in enumerate(rows)}
    pairs = list(points[["comparison", "teacher"]].drop_duplicates().itertuples(index=False, name=None))
    pairs.sort(key=lambda pair: (order[pair[0]], offsets[pair[1]]))
    axes = (
        base.Scale(quantity, base.Kind.PERCENT, grid=True),
        base.Scale(kind=base.Kind.COMPARISONS, rows=rows),
    )
    samples: dict[Any, dict[tuple[str, str], base.Array]] = {step: {} for step in points["step"].unique()}
    values = points["value"].to_numpy(float)
    groups: dict[Any, Any] = points.groupby(["step", "comparison", "teacher"], sort=False).indices
    for (step, anchor, teacher), places in groups.items():
        samples[step][anchor, teacher] = values[places]
    none = values[:0]

    def at(step: Any) -> base.Panel:
        here = samples.get(step, {})
        latest = samples.get(base.END, {}) if step != base.END else {}
        there = {anchor for anchor, _ in here}
        # A comparison that was not evaluated at this step stays as it is at its end.
        shown = [here.get(pair, none) if pair[0] in there else latest.get(pair, none) for pair in pairs]
        marks = [
            _mean(
                sample,
                teacher,
                order[anchor] + float(offsets[teacher]),
                f"{names[teacher]}: {{}}, n = {{}}",
                name=names[teacher],
                comparison=anchor,
            )
            for (anchor, teacher), sample in zip(pairs, shown, strict=True)
        ]
        return base.Panel(*axes, marks)

    return _moving("overview", at, list(samples), heading, caption, len(rows))


def rank_chart(boards: Mapping[str, Sequence[Rank]], name: str = "ranks") -> base.Chart:
    """Return a row for each teacher: its rank by the mean, and the ranks that tests leave open.

    Args:
        boards: ranks on the same challenges, the best first, by conditions and challenges, separated by a
            colon; each is a panel.
        name: identifier of the chart.
    """
    panels = []
    for heading, ranks in boards.items():
        labels = short_labels([rank.teacher for rank in ranks], base.LONGEST_NAME)
        marks = [
            base.Interval(
                x=float(rank.rank),
                y=float(place),
                low=float(rank.best),
                high=float(rank.worst),
                look=look(rank.teacher),
                teacher=rank.teacher,
                words=[f"{labels[rank.teacher]}: rank {rank.rank}, {rank.best} to {rank.worst} open"],
                hover="{text}",
                size=9.0,
                width=3.0,
            )
            for place, rank in enumerate(ranks)
        ]
        x = base.Scale("Rank", low=0.5, high=max(rank.of for rank in ranks) + 0.5, whole=True, grid=True)
        y = base.Scale(kind=base.Kind.TEACHERS, rows={rank.teacher: labels[rank.teacher] for rank in ranks})
        title, _, subtitle = heading.partition(": ")
        panels.append(base.Panel(x, y, marks, f"{title[:1].upper()}{title[1:]}", subtitle))
    caption = (
        "Marks are ranks by the mean. Lines are ranks that tests leave open: the best is one more than the "
        "number of teachers found better, the worst the number of teachers less those found worse."
    )
    size = 6.2, sum(0.7 + 0.24 * len(panel.y.rows) for panel in panels)
    rows = base.grid(panels, 1)
    return base.Chart(name, rows, "Ranks", caption, note=caption, size=size, letters=7.5)


DIFFERENCES = (
    "Differences to Random of mastered test tasks, in points over all challenges, with joint intervals. "
    "In the end: last three evaluations; sooner: mean over training; small marks: for as many trained steps."
)
"""Caption of `difference_chart`."""


def difference_chart(
    beside: Sequence[AgainstRandom], names: Mapping[str, str], heading: str, name: str = "differences"
) -> base.Chart:
    """Return a row for each teacher: its differences to Random with their intervals, axis by axis.

    Small marks are those per trained step.

    Args:
        beside: comparisons with Random on the same challenges, in the order of the rows.
        names: label of each teacher.
        heading: title of the chart.
        name: identifier of the chart.
    """
    rows = {each.teacher: names[each.teacher] for each in beside}
    y, panels = base.Scale(kind=base.Kind.TEACHERS, rows=rows), []
    for axis in (FINAL, HEADLINE):
        shown = (axis, TRAINED) if axis == HEADLINE else (axis,)
        marks = [
            base.Interval(
                x=round(gap.value, 2),
                y=place + 0.25 * (measure == TRAINED),
                low=gap.low,
                high=gap.high,
                look=look(each.teacher),
                teacher=each.teacher,
                words=[f"{rows[each.teacher]}: {gap}, {gap.verdict}"],
                hover="{text}",
                size=4.0 if measure == TRAINED else 7.0,
                width=1.0 if measure == TRAINED else 2.0,
            )
            for place, each in enumerate(beside)
            for measure in shown
            if (gap := each.gaps.get(measure))
        ]
        x = base.Scale("Points beside Random", grid=True)
        panels.append(base.Panel(x, y, [base.Rule(x=0.0), *marks], AXES[axis].capitalize()))
    size = 7.4, 1.0 + 0.21 * len(rows)
    return base.Chart(name, [panels], heading, DIFFERENCES, size=size, letters=7.5)
