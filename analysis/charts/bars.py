"""Bars of results, with the pairs of teachers that differ significantly."""

from __future__ import annotations

import functools
import itertools
import string
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
import pandas as pd

from analysis.charts.base import (
    LEAST_PERCENT,
    MASTERED,
    ONE_COLUMN,
    TWO_COLUMNS,
    Bar,
    Chart,
    Curve,
    Interval,
    Kind,
    Label,
    Legend,
    Mark,
    Panel,
    Rule,
    Scale,
    require,
    require_unique,
    significant,
)
from analysis.data.reference import is_baseline
from analysis.looks import INK, MUTED, Look, look
from analysis.names import label, order, short_labels, teacher_order, title

COLUMNS = 3
"""Panels side by side where there is a single column of them."""

MOST_BRACKETS = 12
"""With more significant pairs in a panel than this, letters are shown instead of brackets."""

LANE = 0.055
"""Width of a lane of brackets or letters, over the length of the axis."""

DOUBT = "\N{DAGGER}"
"""Mark of a result that may be a slip of who published it."""

Pair = tuple[str, str]

Beside = Callable[[float, float], Mark]
"""Draws a mark right of the values, given the start of its lane and the width of lanes."""


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

    def letters(self) -> dict[str, str]:
        """Return the letters of each teacher, with a blank for each it has not; "?" of one never tested."""
        names = list(self.rows.index)
        never = [name for name in names if sum(name in pair for pair in self.untested) >= len(names) - 1]
        numbers = compact_letter_display([name for name in names if name not in never], self.different)
        count = max((number + 1 for own in numbers.values() for number in own), default=0)
        return dict.fromkeys(never, "?") | {
            name: "".join(string.ascii_letters[number] if number in own else " " for number in range(count))
            for name, own in numbers.items()
        }


def bars_with_pairs(
    table: pd.DataFrame,
    tests: pd.DataFrame,
    measure: str = "mastered_percent",
    name: str = MASTERED,
    whisker: Whisker = Whisker.DEVIATION,
    by: tuple[str, str] = ("challenge", "expert_knowledge"),
) -> Chart:
    """Return mean results as bars, a row of panels per challenge and a column per level of expert knowledge.

    Pairs of teachers that differ significantly are joined by brackets. Eight teachers make 28 pairs, most of
    them significant in the paper: so many brackets cannot be told apart at the width of a page. If any panel
    has over `MOST_BRACKETS`, letters say the same in all panels, in a few columns and without loss: two
    teachers share a letter exactly if they do not differ significantly. A dashed line is Random's mean; a
    dash stands where a teacher has no result.

    Args:
        table: results of `pooling.pooled` or `published.paper_frame`, with n.
        tests: all pairs, of `pairwise.pairwise` or `pairwise_statistics.pairwise_from_statistics`.
        measure: measure that is drawn.
        name: its name, with its unit.
        whisker: standard deviation, or standard error of the mean.
        by: columns of both tables that make rows and columns of panels.

    Raises:
        ValueError: nothing to draw, or several results of a teacher in one panel.
    """
    whisker = Whisker(whisker)
    table = _table(table, measure, whisker, by)
    teachers = sorted(table["teacher"].unique(), key=teacher_order)
    results = _results(table, tests, by)
    found = [each for each in itertools.chain(*results) if each]
    brackets = max(len(each.different) for each in found) <= MOST_BRACKETS
    start, end = _limits(table, measure)
    lane = LANE * (end - start)
    marks = {each.titles: list(_bars(each, teachers, start)) for each in found}
    used = 0
    for each in found:
        beside = _brackets(each, teachers) if brackets else _letters(each, teachers)
        for number, draw in beside:
            marks[each.titles].append(draw(end + lane * number, lane))
            used = max(used, number + 1)
    names = short_labels(teachers)
    axes = (
        Scale("", Kind.NUMBER, start, end + lane * (used + 0.5 if used else 0), last_tick=end, grid=True),
        Scale(kind=Kind.TEACHERS, rows={teacher: names[teacher] for teacher in teachers}),
    )
    headings = {each.titles[1] for each in found}
    rows = [
        [each and _panel(each, marks[each.titles], axes, len(headings) == 1, line == 0) for each in row]
        for line, row in enumerate(results)
    ]
    width = TWO_COLUMNS if len(rows[0]) > 1 else ONE_COLUMN
    return Chart(
        "bars",
        rows,
        heading=headings.pop() if len(headings) == 1 else "",
        note="\n".join([f"{name}; whiskers: one {whisker.value}", *_notes(found, brackets)]),
        legend=Legend.NONE,
        size=(width, max(1.7, 0.7 + (0.3 + 0.135 * len(teachers)) * len(rows))),
        letters=6.5,
    )


def _panel(
    each: Results, marks: Sequence[Mark], axes: tuple[Scale, Scale], single: bool, first: bool
) -> Panel:
    """Return a panel, headed by its challenge where there is a `single` column of levels."""
    remark = "no results" if each.rows.empty else ""
    if single:
        return Panel(*axes, marks, each.titles[0], remark=remark)
    return Panel(*axes, marks, each.titles[1] if first else "", side=each.titles[0], remark=remark)


def _table(table: pd.DataFrame, measure: str, whisker: Whisker, by: tuple[str, str]) -> pd.DataFrame:
    """Return `by`, teacher, mean, whisker (0 where there is none) and doubt (empty where there is none)."""
    mean, std = f"{measure}_mean", f"{measure}_std"
    require(table, [*by, "teacher", "n", mean, std], "results")
    table = table[table[mean].notna()]
    require(table, [], f"results with {mean}")
    require_unique(table, [*by, "teacher"], "results")
    error = table[std] / (np.sqrt(table["n"]) if whisker is Whisker.ERROR else 1.0)
    doubt = table["doubt"].fillna("") if "doubt" in table else ""
    columns = {"mean": table[mean].astype(float), "whisker": error.fillna(0.0), "doubt": doubt}
    return table[[*by, "teacher"]].assign(**columns)


def _results(table: pd.DataFrame, tests: pd.DataFrame, by: tuple[str, str]) -> list[list[Results | None]]:
    """Return the results of panels in rows of one length; rows are wrapped if there is a single column."""
    rows, columns = (sorted(table[column].unique(), key=functools.partial(order, column)) for column in by)
    found = [[_at_place(table, tests, by, (row, column)) for column in columns] for row in rows]
    if len(columns) > 1:
        return [list(line) for line in found]
    panels: list[Results | None] = [panel for (panel,) in found]
    panels += [None] * (-len(panels) % COLUMNS if len(panels) > COLUMNS else 0)
    return [panels[start : start + COLUMNS] for start in range(0, len(panels), COLUMNS)]


def _at_place(
    table: pd.DataFrame, tests: pd.DataFrame, by: tuple[str, str], place: tuple[object, object]
) -> Results:
    rows = _at(table, by, place).set_index("teacher")[["mean", "whisker", "doubt"]]
    here = _at(tests, by, place)
    here = here[here["first"].isin(rows.index) & here["second"].isin(rows.index)]
    tested = {frozenset(pair) for pair in _pairs(here[here["p"].notna()])}
    untested = [
        pair for pair in itertools.combinations(sorted(rows.index), 2) if frozenset(pair) not in tested
    ]
    titles = title(by[0], place[0]), title(by[1], place[1])
    return Results(titles, rows, _pairs(significant(here)), untested)


def _at(frame: pd.DataFrame, by: tuple[str, str], place: tuple[object, object]) -> pd.DataFrame:
    """Return the rows of one panel; element by element, since pools are tuples in some tables."""
    here = [values == place for values in frame[list(by)].itertuples(index=False, name=None)]
    return frame[np.array(here, dtype=bool)]


def _pairs(tests: pd.DataFrame) -> list[Pair]:
    return list(tests[["first", "second"]].itertuples(index=False, name=None))


def _limits(table: pd.DataFrame, measure: str) -> tuple[float, float]:
    """Return the ends of the axis of values: no whisker of a percentage goes below 0."""
    percent = measure.endswith("percent")
    low = 0.0 if percent else min(0.0, (table["mean"] - table["whisker"]).min())
    high = max((table["mean"] + table["whisker"]).max(), LEAST_PERCENT if percent else 0.0)
    return 1.02 * low, 1.02 * high if high > low else low + 1.0


def _bars(each: Results, teachers: Sequence[str], start: float) -> Iterator[Mark]:
    for place, teacher in enumerate(teachers):
        if each.rows.empty:
            return
        if teacher not in each.rows.index:
            yield Label(x=start, y=place, text="\N{EN DASH}", look=Look(MUTED, "", "-"), beside=True)
            continue
        mean, whisker = (float(each.rows[name][teacher]) for name in ("mean", "whisker"))
        style = look(teacher)
        if is_baseline(teacher):
            yield Rule(x=mean, look=style._replace(dashes=(0, (3, 2))))
        yield Bar(x=mean, y=place, look=style, teacher=teacher)
        if whisker > 0:
            ends: dict[str, Any] = {
                "low": mean - whisker,
                "high": mean + whisker,
                "size": 0.0,
                "width": 0.95,
                "cap": 2.0,
            }
            yield Interval(x=mean, y=place, look=Look(INK, "", "-"), teacher=teacher, **ends)
        if each.rows["doubt"][teacher]:
            yield Label(x=mean + whisker, y=place, text=DOUBT, beside=True, about=f"doubt-{teacher}")


def _brackets(each: Results, teachers: Sequence[str]) -> Iterator[tuple[int, Beside]]:
    """Yield the lane of a bracket for each pair of teachers that differ, and the bracket."""
    places = {teacher: place for place, teacher in enumerate(teachers)}
    spans = lanes({(min(s), max(s)) for s in ((places[a], places[b]) for a, b in each.different)})
    for (low, high), number in spans.items():
        about = f"{teachers[low]} differs from {teachers[high]}"
        yield number, functools.partial(_bracket, low + 0.16, high - 0.16, about)


def _bracket(low: float, high: float, about: str, start: float, lane: float) -> Mark:
    xs = start + lane * np.array([0.3, 0.75, 0.75, 0.3])
    return Curve(x=xs, y=np.array([low, low, high, high]), look=Look(INK, "", "-"), width=0.95, about=about)


def _letters(each: Results, teachers: Sequence[str]) -> Iterator[tuple[int, Beside]]:
    """Yield the column of each letter of each teacher, and the letter."""
    letters = each.letters()
    for place, teacher in enumerate(teachers):
        for column, letter in enumerate(letters.get(teacher, "")):
            if letter != " ":
                yield column, functools.partial(_letter, place, letter)


def _letter(place: float, letter: str, start: float, lane: float) -> Mark:
    return Label(x=start + 0.6 * lane, y=place, text=letter)


def _notes(panels: Sequence[Results], brackets: bool) -> list[str]:
    sign = "<" if brackets else "\N{GREATER-THAN OR EQUAL TO}"
    test = f"(after Holm, p\N{NO-BREAK SPACE}{sign}\N{NO-BREAK SPACE}0.05)."
    text = "Brackets join teachers that" if brackets else "Teachers that share a letter do not"
    notes = [f"{text} differ significantly {test}"]
    if any(panel.rows["doubt"].astype(bool).any() for panel in panels):
        notes.append(f"{DOUBT} A doubtful result: the tables say why.")
    untested = [(panel, pair) for panel in panels for pair in panel.untested]
    if untested:
        panel, (first, second) = untested[0]
        more = f" and {len(untested) - 1} more" if len(untested) > 1 else ""
        where = ", ".join(panel.titles).lower()
        notes.append(f"Pairs without a test: {label(first)} and {label(second)} ({where}){more}.")
    return notes


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
    """Return for each span of whole numbers a lane, from 0, so that spans in a lane only touch.

    Short spans come first, so that long brackets lie outside.
    """
    found: dict[tuple[int, int], int] = {}
    for low, high in sorted(spans, key=lambda span: (span[1] - span[0], span)):
        taken = {lane for (start, end), lane in found.items() if start < high and low < end}
        found[low, high] = min(set(range(len(spans))) - taken)
    return found
