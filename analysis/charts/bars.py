"""Bars of results, with the pairs of teachers that differ significantly."""

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
from analysis.looks import INK, MUTED, Look, look
from analysis.names import label, order, short_labels, title

COLUMNS = 3
"""Panels side by side where there is a single column of them."""

MOST_BRACKETS = 12
"""With more significant pairs in a panel than this, letters are shown instead of brackets."""

LANE = 0.055
"""Width of a lane of brackets or letters, over the length of the axis."""

DOUBT = "\N{DAGGER}"
"""Mark of a result that may be a slip of who published it."""

Pair = tuple[str, str]


class Whisker(StrEnum):
    """Spreads that whiskers can show."""

    DEVIATION = "standard deviation"
    ERROR = "standard error"


@dataclass(frozen=True, eq=False)
class Results:
    """Results of one panel.

    Attributes:
        titles: titles of its row and its column of panels.
        rows: mean, whisker and doubt by teacher.
        different: pairs that differ significantly.
        untested: pairs without a test.
    """

    titles: tuple[str, str]
    rows: pd.DataFrame
    different: list[Pair]
    untested: list[Pair]


def bars_with_pairs(
    table: pd.DataFrame,
    tests: pd.DataFrame,
    measure: str = "mastered_percent",
    name: str = base.MASTERED,
    whisker: Whisker = Whisker.DEVIATION,
    by: tuple[str, str] = ("challenge", "expert_knowledge"),
) -> base.Chart:
    """Return mean results as bars, a row of panels per challenge and a column per level of expert knowledge.

    Pairs of teachers that differ significantly are joined by brackets. Eight teachers make 28 pairs, most of
    them significant in the paper: so many brackets cannot be told apart at the width of a page. If any panel
    has over `MOST_BRACKETS`, letters say the same in all panels, in a few columns and without loss: two
    teachers share a letter exactly if they do not differ significantly. A dashed line is Random's mean; a
    dash stands where a teacher has no result.

    Args:
        table: results of `pooling.pooled` or `reference.paper_frame`, with n.
        tests: all pairs, of `frame.pairwise` or `frame.pairwise_from_statistics`.
        measure: measure that is drawn.
        name: its name, with its unit.
        whisker: standard deviation, or standard error of the mean.
        by: columns of both tables that make rows and columns of panels.

    Raises:
        ValueError: nothing to draw, or several results of a teacher in one panel.
    """
    whisker = Whisker(whisker)
    mean, std = f"{measure}_mean", f"{measure}_std"
    base.require(table, [*by, "teacher", "n", mean, std], "results")
    table = table[table[mean].notna()]
    base.require(table, [], f"results with {mean}")
    base.require_unique(table, [*by, "teacher"], "results")
    error = table[std] / (np.sqrt(table["n"]) if whisker is Whisker.ERROR else 1.0)
    doubt = table["doubt"].fillna("") if "doubt" in table else ""
    values = {"mean": table[mean].astype(float), "whisker": error.fillna(0.0), "doubt": doubt}
    table = table[[*by, "teacher"]].assign(**values)
    names = short_labels(table["teacher"].unique())
    teachers = list(names)
    rows, columns = (sorted(table[column].unique(), key=functools.partial(order, column)) for column in by)
    results = [[_results(table, tests, by, (row, column)) for column in columns] for row in rows]
    found = list(itertools.chain(*results))
    percent = measure.endswith("percent")  # no whisker of a percentage goes below 0
    low = 0.0 if percent else min(0.0, (table["mean"] - table["whisker"]).min())
    high = max((table["mean"] + table["whisker"]).max(), base.LEAST_PERCENT if percent else 0.0)
    start, end = 1.02 * low, 1.02 * high if high > low else low + 1.0
    lane = LANE * (end - start)
    brackets = max(len(each.different) for each in found) <= MOST_BRACKETS
    beside = [list((_brackets if brackets else _letters)(each, teachers, end, lane)) for each in found]
    used = max((number + 1 for marks in beside for number, _ in marks), default=0)
    axes = (
        base.Scale(
            "", base.Kind.NUMBER, start, end + lane * (used + 0.5 if used else 0), last_tick=end, grid=True
        ),
        base.Scale(kind=base.Kind.TEACHERS, rows=names),
    )
    single = len(columns) == 1
    panels = [
        base.Panel(
            *axes,
            [*_bars(each, teachers, start), *(mark for _, mark in marks)],
            each.titles[0] if single else each.titles[1] if place < len(columns) else "",
            side="" if single else each.titles[0],
            remark="no results" if each.rows.empty else "",
        )
        for place, (each, marks) in enumerate(zip(found, beside, strict=True))
    ]
    lines = base.grid(panels, COLUMNS if single else len(columns))
    return base.Chart(
        "bars",
        lines,
        heading=found[0].titles[1] if single else "",
        note="\n".join([f"{name}; whiskers: one {whisker.value}", *_notes(found, brackets)]),
        legend=base.Legend.NONE,
        size=(
            base.TWO_COLUMNS if len(lines[0]) > 1 else base.ONE_COLUMN,
            max(1.7, 0.7 + (0.3 + 0.135 * len(teachers)) * len(lines)),
        ),
        letters=6.5,
    )


def _results(
    table: pd.DataFrame, tests: pd.DataFrame, by: tuple[str, str], place: tuple[object, object]
) -> Results:
    def pairs(tests: pd.DataFrame) -> list[Pair]:
        return list(tests[["first", "second"]].itertuples(index=False, name=None))

    rows, here = (  # element by element, since pools are tuples in some tables
        frame[np.array([values == place for values in zip(*(frame[each] for each in by), strict=True)], bool)]
        for frame in (table, tests)
    )
    rows = rows.set_index("teacher")[["mean", "whisker", "doubt"]]
    here = here[here["first"].isin(rows.index) & here["second"].isin(rows.index)]
    tested = set(map(frozenset, pairs(here[here["p"].notna()])))
    every = itertools.combinations(sorted(rows.index), 2)
    untested = [pair for pair in every if frozenset(pair) not in tested]
    return Results(
        (title(by[0], place[0]), title(by[1], place[1])), rows, pairs(base.significant(here)), untested
    )


def _bars(each: Results, teachers: Sequence[str], start: float) -> Iterator[base.Mark]:
    line = Look(INK, "", "-")
    for place, teacher in enumerate(() if each.rows.empty else teachers):
        if teacher not in each.rows.index:
            yield base.Label(
                x=start, y=place, text="\N{EN DASH}", look=line._replace(colour=MUTED), beside=True
            )
            continue
        mean, whisker = (float(each.rows[name][teacher]) for name in ("mean", "whisker"))
        if is_baseline(teacher):
            yield base.Rule(x=mean, look=look(teacher)._replace(dashes=(0, (3, 2))))
        yield base.Bar(x=mean, y=place, look=look(teacher), teacher=teacher)
        if whisker > 0:
            ends: dict[str, Any] = {"low": mean - whisker, "high": mean + whisker}
            style: dict[str, Any] = {"size": 0.0, "width": 0.95, "cap": 2.0}
            yield base.Interval(x=mean, y=place, look=line, teacher=teacher, **ends, **style)
        if each.rows["doubt"][teacher]:
            yield base.Label(x=mean + whisker, y=place, text=DOUBT, beside=True, about=f"doubt-{teacher}")


def _brackets(
    each: Results, teachers: Sequence[str], start: float, lane: float
) -> Iterator[tuple[int, base.Mark]]:
    """Yield a bracket for each pair of teachers that differ, and its lane; the first is at `start`."""
    places = {teacher: place for place, teacher in enumerate(teachers)}
    spans = lanes({(min(s), max(s)) for s in ((places[a], places[b]) for a, b in each.different)})
    for (low, high), number in spans.items():
        about = f"{teachers[low]} differs from {teachers[high]}"
        xs = start + lane * number + lane * np.array([0.3, 0.75, 0.75, 0.3])
        ys = np.array([low + 0.16, low + 0.16, high - 0.16, high - 0.16])
        yield number, base.Curve(x=xs, y=ys, look=Look(INK, "", "-"), width=0.95, about=about)


def _letters(
    each: Results, teachers: Sequence[str], start: float, lane: float
) -> Iterator[tuple[int, base.Mark]]:
    """Yield the letters of each teacher and their columns; "?" of one that was never tested."""
    names = list(each.rows.index)
    never = [name for name in names if sum(name in pair for pair in each.untested) >= len(names) - 1]
    letters = compact_letter_display([name for name in names if name not in never], each.different)
    for place, teacher in enumerate(teachers):
        for column in [0] if teacher in never else letters.get(teacher, ()):
            text = "?" if teacher in never else string.ascii_letters[column]
            yield column, base.Label(x=start + lane * column + 0.6 * lane, y=place, text=text)


def _notes(panels: Sequence[Results], brackets: bool) -> Iterator[str]:
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
        where = ", ".join(panel.titles).lower()
        yield f"Pairs without a test: {label(first)} and {label(second)} ({where}){more}."


def compact_letter_display(names: Sequence[str], different: Iterable[Pair]) -> dict[str, list[int]]:
    """Return the compact letter display: letters of each name, from 0; two share one exactly if alike.

    Alike are those that do not differ. Piepho's insert-and-absorb algorithm (Journal of Computational and
    Graphical Statistics 13, 2004) asks for no order among names, and so is exact for tests with unequal
    variances, which are not transitive. Letters are numbered by the first of `names` that has them.

    Args:
        names: names that were compared.
        different: pairs that differ significantly.
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
    """Return the lane of each span of whole numbers, from 0, such that spans in a lane do not overlap.

    Short spans come first, so that long brackets lie outside.
    """
    found: dict[tuple[int, int], int] = {}
    for low, high in sorted(spans, key=lambda span: (span[1] - span[0], span)):
        taken = {lane for (start, end), lane in found.items() if start < high and low < end}
        found[low, high] = min(set(range(len(spans))) - taken)
    return found
