"""Charts with intervals: means, ranks, differences, performance profiles, and interim looks of a trial."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from analysis.charts import base
from analysis.comparisons.against_random import AgainstRandom
from analysis.comparisons.budgets import BudgetComparison
from analysis.comparisons.ranks import Rank
from analysis.formatting import number, steps_text
from analysis.measures.tested import AXES, FINAL, HEADLINE, TRAINED
from analysis.names import label, marked_label, short_labels
from analysis.statistics import describe, mean_percent_interval
from analysis.teacher_styles import INK, MUTED, TeacherStyle, teacher_style


def seeds_chart(points: pd.DataFrame, quantity: str, name: str, heading: str, caption: str) -> base.Chart:
    """Return a chart with a row per teacher, which shows runs as rings and their mean with its 95 % interval.

    Args:
        points: teacher, seed, step (of an evaluation, or `END`) and value, in per cent.
        quantity: title of the horizontal axis.
        name: identifier of the chart.
        heading: title of the chart.
        caption: content and number of runs.
    """
    rows = short_labels(map(str, points["teacher"].unique()), base.LONGEST_NAME)
    axes = (
        base.PanelAxis(quantity, base.AxisKind.PERCENT, grid=True),
        base.PanelAxis(kind=base.AxisKind.TEACHERS, rows=rows),
    )
    finite = points[points["value"].notna()]
    groups = finite.groupby(["step", "teacher"], sort=False).indices
    values, seeds = finite["value"].to_numpy(float), finite["seed"].to_numpy(object)

    def at(step: Any) -> base.Panel:
        marks = list[base.Mark]()
        for y, (teacher, short) in enumerate(rows.items()):
            indices = groups.get((step, teacher), [])
            marks.append(
                base.Scatter(
                    x=[round(value, 2) for value in values[indices].tolist()],
                    y=[y] * len(indices),
                    texts=[f"{short}, seed {seed}" for seed in seeds[indices]],
                    hover="{text}: {x:.1f}",
                    look=teacher_style(teacher)._replace(marker="o"),
                    teacher=teacher,
                    size=8.0,
                    hollow=True,
                    opacity=0.75,
                )
            )
            words, style = f"{short}: mean {{}} of {{}}", {"size": 11.0, "width": 2.0, "cap": 5.0}
            marks.append(_mean(values[indices], teacher, y, words, **style))
        return base.Panel(*axes, marks)

    return _chart(name, at, list(dict.fromkeys(points["step"])), heading, caption, len(rows))


def _mean(values: base.Array, teacher: str, y: float, words: str, **style: Any) -> base.Interval:
    """Return a mark of the mean with its 95 % interval; `words` is a template for the hover text."""
    sample = describe(values)
    low, high = mean_percent_interval(sample) if sample.n else (math.nan, math.nan)
    text = words.format(number(sample.mean), sample.n) if sample.n else ""
    if math.isfinite(low):
        text += f", 95 % interval {number(low)} to {number(high)}"
    return base.Interval(
        x=round(sample.mean, 2) if sample.n else math.nan,
        y=round(y, 3),
        low=low,
        high=high,
        texts=[text],
        hover="{text}",
        look=teacher_style(teacher),
        teacher=teacher,
        **style,
    )


def _chart(
    name: str, at: Any, moments: Sequence[object], heading: str, caption: str, rows: int
) -> base.Chart:
    """Return a chart with a single animated panel."""
    return base.Chart(
        name, [[base.animated(at, moments, base.END)]], heading, caption, size=(5.2, 0.9 + 0.42 * rows)
    )


def overview_chart(
    points: pd.DataFrame, rows: Mapping[str, str], quantity: str, heading: str, caption: str
) -> base.Chart:
    """Return a chart with a row per comparison: the mean of each teacher and its 95 % interval.

    Args:
        points: comparison (anchor), teacher, step (of an evaluation, or `END`) and value (%) of a run.
        rows: title of each comparison by its anchor, in order.
        quantity: title of the horizontal axis.
        heading: title of the chart.
        caption: content and number of runs.
    """
    names = short_labels(map(str, points["teacher"].unique()), base.LONGEST_NAME)
    offsets = dict(zip(names, np.linspace(-0.33, 0.33, len(names) + 2)[1:-1], strict=True))
    order = {anchor: index for index, anchor in enumerate(rows)}
    pairs = list(points[["comparison", "teacher"]].drop_duplicates().itertuples(index=False, name=None))
    pairs.sort(key=lambda pair: (order[pair[0]], offsets[pair[1]]))
    axes = (
        base.PanelAxis(quantity, base.AxisKind.PERCENT, grid=True),
        base.PanelAxis(kind=base.AxisKind.COMPARISONS, rows=rows),
    )
    samples: dict[Any, dict[tuple[str, str], base.Array]] = {step: {} for step in points["step"].unique()}
    values = points["value"].to_numpy(float)
    groups: dict[Any, Any] = points.groupby(["step", "comparison", "teacher"], sort=False).indices
    for (step, anchor, teacher), indices in groups.items():
        samples[step][anchor, teacher] = values[indices]
    none = values[:0]

    def at(step: Any) -> base.Panel:
        by_pair = samples.get(step, {})
        evaluated = {anchor for anchor, _ in by_pair}
        # a comparison that was not evaluated at this step shows its final results
        latest = samples.get(base.END, {}) if step != base.END else {}
        shown = [(by_pair if pair[0] in evaluated else latest).get(pair, none) for pair in pairs]
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

    return _chart("overview", at, list(samples), heading, caption, len(rows))


def rank_chart(boards: Mapping[str, Sequence[Rank]], name: str = "ranks") -> base.Chart:
    """Return a chart of each teacher's rank by mean, and of the ranks that its tests do not rule out.

    Args:
        boards: ranks of each panel, best first, by heading and subtitle, separated by a colon.
        name: identifier of the chart.
    """
    panels = []
    for heading, ranks in boards.items():
        labels = short_labels([rank.teacher for rank in ranks], base.LONGEST_NAME)
        marks = [
            base.Interval(
                x=float(rank.rank),
                y=float(y),
                low=float(rank.best),
                high=float(rank.worst),
                look=teacher_style(rank.teacher),
                teacher=rank.teacher,
                texts=[f"{labels[rank.teacher]}: rank {rank.rank}, {rank.best} to {rank.worst} open"],
                hover="{text}",
                size=9.0,
                width=3.0,
            )
            for y, rank in enumerate(ranks)
        ]
        x = base.PanelAxis("Rank", low=0.5, high=max(rank.of for rank in ranks) + 0.5, whole=True, grid=True)
        y = base.PanelAxis(
            kind=base.AxisKind.TEACHERS, rows={rank.teacher: labels[rank.teacher] for rank in ranks}
        )
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
    "Differences to Random of mastered test tasks, in points, with joint intervals. "
    "In the end: last three evaluations; sooner: mean over training; small marks: for as many trained steps."
)
"""Caption of `difference_chart`."""


def difference_chart(
    beside: Sequence[AgainstRandom], names: Mapping[str, str], heading: str, name: str = "differences"
) -> base.Chart:
    """Return a chart of differences from Random, with intervals, by teacher (row) and measure (panel).

    Small marks are differences per trained step.

    Args:
        beside: comparisons with Random, in the order of the rows.
        names: label of each teacher.
        heading: title of the chart.
        name: identifier of the chart.
    """
    rows = {comparison.teacher: names[comparison.teacher] for comparison in beside}
    teachers, panels = base.PanelAxis(kind=base.AxisKind.TEACHERS, rows=rows), []
    for axis in (FINAL, HEADLINE):
        shown = (axis, TRAINED) if axis == HEADLINE else (axis,)
        marks = [
            base.Interval(
                x=round(gap.value, 2),
                y=y + 0.25 * (measure == TRAINED),
                low=gap.low,
                high=gap.high,
                look=teacher_style(comparison.teacher),
                teacher=comparison.teacher,
                texts=[f"{rows[comparison.teacher]}: {gap}, {gap.verdict}"],
                hover="{text}",
                size=4.0 if measure == TRAINED else 7.0,
                width=1.0 if measure == TRAINED else 2.0,
            )
            for y, comparison in enumerate(beside)
            for measure in shown
            if (gap := comparison.gaps.get(measure))
        ]
        x = base.PanelAxis("Points beside Random", grid=True)
        panels.append(base.Panel(x, teachers, [base.ReferenceLine(x=0.0), *marks], AXES[axis].capitalize()))
    size = 7.4, 1.0 + 0.21 * len(rows)
    return base.Chart(name, [panels], heading, DIFFERENCES, size=size, letters=7.5)


FEWEST_WITH_BAND = 5  # minimum number of runs for a band; with fewer, bands would fill the panel


def profile_chart(table: pd.DataFrame, quantity: str, name: str, heading: str, caption: str) -> base.Chart:
    """Return a chart of performance profiles (share of runs above each threshold), with a line per teacher.

    Args:
        table: teacher, threshold, share, low, high and n, from `aggregates.profiles`.
        quantity: title of the axis of thresholds.
        name: identifier of the chart.
        heading: title of the chart.
        caption: content and number of runs.
    """
    marks: list[base.Mark] = []
    for teacher, short in short_labels(table["teacher"].astype(str), base.LONGEST_NAME).items():
        rows = table[table["teacher"] == teacher].sort_values("threshold")
        share, low, high = (100 * rows[column].to_numpy(np.float64) for column in ("share", "low", "high"))
        band: dict[str, Any] = {"low": low, "high": high} if rows["n"].min() >= FEWEST_WITH_BAND else {}
        words = [f"{y:.0f} % [{a:.0f}, {b:.0f}]" for y, a, b in zip(share, low, high, strict=True)]
        marks.append(
            base.Curve(
                x=rows["threshold"].to_numpy(np.float64),
                y=share,
                **band,
                look=teacher_style(teacher)._replace(marker=""),
                name=short,
                teacher=teacher,
                texts=words,
                hover="{text}",
                opacity=0.1,
            )
        )
    axes = (
        base.PanelAxis(quantity, low=0.0, high=100.0),
        base.PanelAxis("Runs over it (%)", low=-2.0, high=102.0, grid=True),
    )
    return base.Chart(name, [[base.Panel(*axes, marks)]], heading, caption)


ORDERS = (
    "Order of teachers by their mean after each budget, in runs of the longest. Lines that cross are pairs "
    "that change places."
)
"""Caption of `budget_chart`."""


def budget_chart(
    comparison: BudgetComparison, names: Mapping[str, str], heading: str, name: str = "budgets"
) -> base.Chart:
    """Return a chart of teachers' ranks after each budget, with a line per teacher and a panel per measure.

    Args:
        comparison: teachers at several budgets.
        names: label of each teacher.
        heading: title of the chart.
        name: identifier of the chart.
    """
    budgets, count = comparison.budgets, len(comparison.means)
    steps = {str(budget): steps_text(budget) for budget in budgets}
    x = base.PanelAxis("Environment steps", base.AxisKind.NAMES, -0.2, len(budgets) + 0.6, rows=steps)
    positions = {str(rank): str(rank) for rank in range(1, count + 1)}
    y = base.PanelAxis("Rank", base.AxisKind.NAMES, rows=positions)
    panels = []
    for axis in (HEADLINE, FINAL):
        ranks = pd.DataFrame(comparison.means[axis]).rank(ascending=False, method="first")
        marks: list[base.Mark] = []
        for teacher, row in ranks.iterrows():
            order, short = row.loc[budgets].to_numpy(float) - 1, names[str(teacher)]
            texts = [
                f"{short}, {steps_text(budget)} steps: rank {index + 1:.0f}"
                for budget, index in zip(budgets, order, strict=True)
            ]
            marks.append(
                base.Curve(
                    x=np.arange(len(budgets), dtype=float),
                    y=order,
                    look=teacher_style(str(teacher)),
                    teacher=str(teacher),
                    texts=texts,
                    hover="{text}",
                )
            )
            marks.append(
                base.Label(x=len(budgets) - 0.85, y=order[-1], text=short, beside=True, teacher=str(teacher))
            )
        panels.append(base.Panel(x, y, marks, AXES[axis].capitalize()))
    return base.Chart(name, [panels], heading, ORDERS, size=(8.4, 1.2 + 0.19 * count), letters=7.5)


BOUNDARY, BAND = TeacherStyle(INK, "", (0, (4, 2))), TeacherStyle(MUTED, "", "-")
"""Styles of boundaries and of the margin."""

ROOM = 1.4  # limit of the vertical axis as a multiple of the largest value, margin or (after look 1) boundary


def course_chart(
    courses: Mapping[tuple[str, str], pd.DataFrame],
    teacher: str,
    margins: Mapping[str, float],
    name: str = "course",
) -> base.Chart:
    """Return a chart of a trial with a panel per comparison: differences by look, boundaries and margin.

    Args:
        courses: rows from `trials.interim.course` by measure and reference, with a row of panels per measure.
        teacher: new teacher.
        margins: equivalence margin of each measure, in points.
        name: identifier of the chart.
    """
    panels: dict[str, list[base.Panel]] = {}
    for (measure, reference), table in courses.items():
        margin = margins[measure]
        seeds, seen = table["seeds"].astype(float), table[table["value"].notna()]
        later = table.loc[seeds > seeds.min(), ["better", "worse"]].abs().to_numpy().max()
        reach = ROOM * float(max(later, margin, seen["value"].abs().max() if len(seen) else 0.0))
        x = base.PanelAxis(
            "Seeds of every cell", low=float(seeds.min()) - 1, high=float(seeds.max()) + 1, whole=True
        )
        y = base.PanelAxis("Difference (points)", low=-reach, high=reach, grid=True)
        title = _heading(measure, [reference]) if len(courses) > 1 else ""
        width = np.array([seeds.iloc[0] - 1, seeds.iloc[-1] + 1])
        band = base.Curve(x=width, low=np.full(2, -margin), high=np.full(2, margin), look=BAND)
        marks = [
            band,
            base.ReferenceLine(y=0.0, look=BAND, width=0.8),
            *_course(table, seen, teacher, 2 * reach),
        ]
        panels.setdefault(measure, []).append(base.Panel(x, y, marks, title))
    caption = (
        "Difference with its repeated confidence interval at each look. Over the upper boundary the teacher "
        "is better, under the lower one worse, and alike where all of the interval is in the grey band. "
        "Boundaries of looks to come are those that the release's spread lets expect."
    )
    measures, references = (dict.fromkeys(names) for names in zip(*courses, strict=True))
    heading = " and ".join(_heading(measure, references) for measure in measures)
    return base.Chart(name, [*panels.values()], heading, caption, size=(base.TWO_COLUMNS, 2.9 * len(panels)))


def _heading(measure: str, references: Iterable[str]) -> str:
    """Return a heading with the measure and the references."""
    return f"{AXES[measure].capitalize()}, against {' and '.join(map(label, references))}"


def _course(table: pd.DataFrame, seen: pd.DataFrame, teacher: str, reach: float) -> Iterator[base.Curve]:
    """Yield curves of the boundaries and intervals, clipped to ± `reach`, and of the observed differences."""
    for side, name in (("better", "boundary of a verdict"), ("worse", "")):
        bounds = np.clip(table[side].to_numpy(float), -reach, reach)
        seeds, hover = table["seeds"].to_numpy(float), f"{side} beyond {{y:.1f}}"
        yield base.Curve(x=seeds, y=bounds, look=BOUNDARY, width=1.2, name=name, hover=hover)
    style = teacher_style(teacher)
    for x, low, high in seen[["seeds", "low", "high"]].to_numpy(float):
        ends = np.clip([low, high], -reach, reach)
        yield base.Curve(x=np.full(2, x), y=ends, look=style._replace(dashes="-"), width=1.4)
    if len(seen):
        yield base.Curve(
            x=seen["seeds"].to_numpy(float),
            y=seen["value"].to_numpy(float),
            look=style,
            name=marked_label(teacher),
            hover="{y:.1f} after {x} seeds",
        )
