"""Bar charts of results, with brackets or letters for significant differences."""

import functools
import itertools
import string
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
import pandas as pd

from analysis.charts import base
from analysis.data.reference import is_baseline
from analysis.names import label, order, short_labels, title
from analysis.teacher_styles import INK, MUTED, TeacherStyle, teacher_style

COLUMNS = 3  # number of panels per row if the second column of `by` has a single value
MOST_BRACKETS = 12  # if any panel needs more brackets, all panels show letters instead
LANE = 0.055  # width of a lane of brackets or letters, as a share of the axis
DOUBT = "\N{DAGGER}"  # mark of published results that are in doubt

Pair = tuple[str, str]


class Whisker(StrEnum):
    """Measure of spread shown by whiskers."""

    DEVIATION = "standard deviation"
    ERROR = "standard error"


@dataclass(frozen=True, eq=False)
class PanelResults:
    """Results of one panel, with the pairs of teachers that differ significantly or have no test."""

    titles: tuple[str, str]  # titles of the panel's row and column
    rows: pd.DataFrame  # mean, whisker and doubt of each result, indexed by teacher
    different: list[Pair]  # pairs that differ significantly
    untested: list[Pair]  # pairs without a test


def bars_with_pairs(
    table: pd.DataFrame,
    tests: pd.DataFrame,
    measure: str = "mastered_percent",
    name: str = base.MASTERED,
    whisker: Whisker = Whisker.DEVIATION,
    by: tuple[str, str] = ("challenge", "expert_knowledge"),
) -> base.Chart:
    """Return a bar chart of mean results, with a panel per challenge (row) and knowledge level (column).

    Brackets join teachers that differ significantly. If a panel has more than `MOST_BRACKETS`, all panels
    have letters instead: two teachers share a letter exactly if they do not differ significantly. A dashed
    line is Random's mean, a dash a missing result.

    Args:
        table: results from `pooling.pooled` or `reference.paper_frame`, with n.
        tests: all pairs, from `pairwise.pairwise` or `pairwise.pairwise_from_statistics`.
        measure: measure to draw.
        name: name of the measure with its unit.
        whisker: standard deviation, or standard error of the mean.
        by: columns of both tables for the rows and the columns of panels.

    Raises:
        ValueError: if there is nothing to draw, or a teacher has several results in one panel.
    """
    whisker = Whisker(whisker)
    mean, std = f"{measure}_mean", f"{measure}_std"
    base.check_table(table, [*by, "teacher", "n", mean, std], "results")
    table = table[table[mean].notna()]
    base.check_table(table, [], f"results with {mean}")
    base.check_unique(table, [*by, "teacher"], "results")
    error = table[std] / (np.sqrt(table["n"]) if whisker is Whisker.ERROR else 1.0)
    doubt = table["doubt"].fillna("") if "doubt" in table else ""
    values = {"mean": table[mean].astype(float), "whisker": error.fillna(0.0), "doubt": doubt}
    table = table[[*by, "teacher"]].assign(**values)
    names = short_labels(table["teacher"].unique())
    teachers = list(names)
    rows, columns = (sorted(table[column].unique(), key=functools.partial(order, column)) for column in by)
    results = [_results(table, tests, by, (row, column)) for row in rows for column in columns]
    percent = measure.endswith("percent")  # percentages: the axis starts at 0
    low = 0.0 if percent else min(0.0, (table["mean"] - table["whisker"]).min())
    high = max((table["mean"] + table["whisker"]).max(), base.LEAST_PERCENT if percent else 0.0)
    start, end = 1.02 * low, 1.02 * high if high > low else low + 1.0
    lane = LANE * (end - start)
    brackets = max(len(result.different) for result in results) <= MOST_BRACKETS
    lane_marks = [
        list((_brackets if brackets else _letters)(result, teachers, end, lane)) for result in results
    ]
    used = max((number + 1 for marks in lane_marks for number, _ in marks), default=0)
    high = end + lane * (used + 0.5 if used else 0)
    axes = (
        base.PanelAxis("", base.AxisKind.NUMBER, start, high, last_tick=end, grid=True),
        base.PanelAxis(kind=base.AxisKind.TEACHERS, rows=names),
    )
    single = len(columns) == 1
    panels = [
        base.Panel(
            *axes,
            [*_bars(result, teachers, start), *(mark for _, mark in marks)],
            result.titles[0] if single else result.titles[1] if index < len(columns) else "",
            side="" if single else result.titles[0],
            empty_text="no results" if result.rows.empty else "",
        )
        for index, (result, marks) in enumerate(zip(results, lane_marks, strict=True))
    ]
    lines = base.grid(panels, COLUMNS if single else len(columns))
    return base.Chart(
        "bars",
        lines,
        heading=results[0].titles[1] if single else "",
        note="\n".join([f"{name}; whiskers: one {whisker.value}", *_notes(results, brackets)]),
        legend=base.Legend.NONE,
        size=(
            base.TWO_COLUMNS if len(lines[0]) > 1 else base.ONE_COLUMN,
            max(1.7, 0.7 + (0.3 + 0.135 * len(teachers)) * len(lines)),
        ),
        letters=6.5,
    )


def _results(
    table: pd.DataFrame, tests: pd.DataFrame, by: tuple[str, str], key: tuple[object, object]
) -> PanelResults:
    def pairs(tests: pd.DataFrame) -> list[Pair]:
        return list(tests[["first", "second"]].itertuples(index=False, name=None))

    rows, tests = (  # pandas' == would compare a tuple (a pool) elementwise
        frame[
            np.array([values == key for values in zip(*(frame[column] for column in by), strict=True)], bool)
        ]
        for frame in (table, tests)
    )
    rows = rows.set_index("teacher")[["mean", "whisker", "doubt"]]
    tests = tests[tests["first"].isin(rows.index) & tests["second"].isin(rows.index)]
    tested = set(map(frozenset, pairs(tests[tests["p"].notna()])))
    possible = itertools.combinations(sorted(rows.index), 2)
    untested = [pair for pair in possible if frozenset(pair) not in tested]
    titles = title(by[0], key[0]), title(by[1], key[1])
    return PanelResults(titles, rows, pairs(base.significant(tests)), untested)


def _bars(results: PanelResults, teachers: Sequence[str], start: float) -> Iterator[base.Mark]:
    line, rows = TeacherStyle(INK, "", "-"), results.rows
    for y, teacher in enumerate(() if rows.empty else teachers):
        if teacher not in rows.index:
            yield base.Label(x=start, y=y, text="\N{EN DASH}", look=line._replace(colour=MUTED), beside=True)
            continue
        mean, whisker = (float(rows[name][teacher]) for name in ("mean", "whisker"))
        if is_baseline(teacher):
            yield base.ReferenceLine(x=mean, look=teacher_style(teacher)._replace(dashes=(0, (3, 2))))
        yield base.Bar(x=mean, y=y, look=teacher_style(teacher), teacher=teacher)
        if whisker > 0:
            ends: dict[str, Any] = {"low": mean - whisker, "high": mean + whisker}
            style: dict[str, Any] = {"size": 0.0, "width": 0.95, "cap": 2.0}
            yield base.Interval(x=mean, y=y, look=line, teacher=teacher, **ends, **style)
        if rows["doubt"][teacher]:
            yield base.Label(x=mean + whisker, y=y, text=DOUBT, beside=True, svg_id=f"doubt-{teacher}")


def _brackets(
    results: PanelResults, teachers: Sequence[str], start: float, lane: float
) -> Iterator[tuple[int, base.Mark]]:
    """Yield the lane and bracket of each pair of teachers that differ significantly."""
    ys = {teacher: y for y, teacher in enumerate(teachers)}
    spans = lanes({(min(s), max(s)) for s in ((ys[a], ys[b]) for a, b in results.different)})
    for (low, high), number in spans.items():
        svg_id = f"{teachers[low]} differs from {teachers[high]}"
        xs = start + lane * number + lane * np.array([0.3, 0.75, 0.75, 0.3])
        heights = np.array([low + 0.16, low + 0.16, high - 0.16, high - 0.16])
        yield number, base.Curve(x=xs, y=heights, look=TeacherStyle(INK, "", "-"), width=0.95, svg_id=svg_id)


def _letters(
    results: PanelResults, teachers: Sequence[str], start: float, lane: float
) -> Iterator[tuple[int, base.Mark]]:
    """Yield the lane and label of each teacher's letters, or of "?" for a teacher without any test."""
    names = list(results.rows.index)
    never = [name for name in names if sum(name in pair for pair in results.untested) >= len(names) - 1]
    letters = compact_letter_display([name for name in names if name not in never], results.different)
    for y, teacher in enumerate(teachers):
        for column in [0] if teacher in never else letters.get(teacher, ()):
            text = "?" if teacher in never else string.ascii_letters[column]
            yield column, base.Label(x=start + lane * column + 0.6 * lane, y=y, text=text)


def _notes(panels: Sequence[PanelResults], brackets: bool) -> Iterator[str]:
    sign = "<" if brackets else "\N{GREATER-THAN OR EQUAL TO}"
    test = f"(after Holm, p\N{NO-BREAK SPACE}{sign}\N{NO-BREAK SPACE}0.05)."
    text = "Brackets join teachers that" if brackets else "Teachers that share a letter do not"
    yield f"{text} differ significantly {test}"
    if any(panel.rows["doubt"].astype(bool).any() for panel in panels):
        yield f"{DOUBT} A doubtful result: the tables say why."
    untested = [(panel, pair) for panel in panels for pair in panel.untested]
    if untested:
        panel, (first, second) = untested[0]
        more = f" and {len(untested) - 1} more" if len(untested) > 1 else ""
        titles = ", ".join(panel.titles).lower()
        yield f"Pairs without a test: {label(first)} and {label(second)} ({titles}){more}."


def compact_letter_display(names: Sequence[str], different: Iterable[Pair]) -> dict[str, list[int]]:
    """Return a compact letter display: names share a letter if and only if not significantly different.

    Piepho's insert-and-absorb algorithm (Journal of Computational and Graphical Statistics 13, 2004) needs no
    order among names, so it is exact for tests with unequal variances, which are not transitive.

    Args:
        names: names that were compared.
        different: pairs that differ significantly.

    Returns:
        Indices of each name's letters, which are numbered in the order of their first names.
    """
    groups = [frozenset(names)] if names else []
    for first, second in different:
        split = []
        for group in groups:
            apart = first in group and second in group
            split += [group - {first}, group - {second}] if apart else [group]
        distinct = list(dict.fromkeys(split))
        groups = [group for group in distinct if not any(group < other for other in distinct)]
    groups.sort(key=lambda group: [names.index(name) for name in names if name in group])
    return {name: [letter for letter, group in enumerate(groups) if name in group] for name in names}


def lanes(spans: Collection[tuple[int, int]]) -> dict[tuple[int, int], int]:
    """Assign spans to lanes so that no two in a lane overlap, with the longest spans outermost."""
    lane_of: dict[tuple[int, int], int] = {}
    for low, high in sorted(spans, key=lambda span: (span[1] - span[0], span)):
        taken = {lane for (start, end), lane in lane_of.items() if start < high and low < end}
        lane_of[low, high] = min(set(range(len(spans))) - taken)
    return lane_of
