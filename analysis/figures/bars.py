"""Bars of results, with the pairs of teachers that differ significantly."""

from __future__ import annotations

import functools
import itertools
import string
import textwrap
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from analysis.data.reference import is_baseline
from analysis.figures.elements import LEAST_PERCENT, remark, require, require_unique, significant
from analysis.figures.style import ONE_COLUMN, TWO_COLUMNS, styled
from analysis.looks import INK, MUTED, look
from analysis.names import label, order, short_labels, teacher_order, title

Pair = tuple[str, str]


def compact_letter_display(names: Sequence[str], different: Iterable[Pair]) -> dict[str, list[int]]:
    """Returns the compact letter display: letters of each name, from 0; two share one exactly if alike.

    Alike are those that do not differ. Piepho's insert-and-absorb algorithm (Journal of Computational and
    Graphical Statistics 13, 2004) asks for no order among names, and so is exact for tests with unequal
    variances, which are not transitive. Letters are numbered by the first of `names` that has them.

    Args:
        names: what was compared.
        different: pairs that differ significantly.
    """
    groups = [frozenset(names)] if names else []
    for first, second in different:
        split = []
        for group in groups:
            if first in group and second in group:
                split += [group - {first}, group - {second}]
            else:
                split.append(group)
        groups = _absorbed(split)
    groups.sort(key=lambda group: [names.index(name) for name in names if name in group])
    return {name: [letter for letter, group in enumerate(groups) if name in group] for name in names}


def _absorbed(groups: Sequence[frozenset[str]]) -> list[frozenset[str]]:
    """Returns `groups` without those that lie within another."""
    distinct = list(dict.fromkeys(groups))
    return [group for group in distinct if not any(group < other for other in distinct)]


def lanes(spans: Collection[tuple[int, int]]) -> dict[tuple[int, int], int]:
    """Returns for each span of whole numbers a lane, from 0, so that spans in a lane only touch.

    Short spans come first, so that long brackets lie outside.
    """
    found: dict[tuple[int, int], int] = {}
    for low, high in sorted(spans, key=lambda span: (span[1] - span[0], span)):
        taken = {lane for (start, end), lane in found.items() if start < high and low < end}
        found[low, high] = min(set(range(len(spans))) - taken)
    return found


COLUMNS = 3
"""Panels side by side where there is a single column of them."""


@dataclass(frozen=True, eq=False)
class BarPanel:
    """One panel.

    Attributes:
        titles: of its row and its column of panels.
        rows: by teacher: mean, whisker and doubt; missing where results are.
        different: pairs that differ significantly.
        untested: pairs without a test.
    """

    titles: tuple[str, str]
    rows: pd.DataFrame
    different: list[Pair]
    untested: list[Pair]

    def letters(self) -> dict[str, str]:
        """Returns the letters of each teacher, with a blank for each it has not; "?" of one never tested."""
        names = list(self.rows.index)
        never = [name for name in names if self._never_tested(name)]
        numbers = compact_letter_display([name for name in names if name not in never], self.different)
        count = max((number + 1 for own in numbers.values() for number in own), default=0)
        return dict.fromkeys(never, "?") | {
            name: "".join(string.ascii_letters[number] if number in own else " " for number in range(count))
            for name, own in numbers.items()
        }

    def _never_tested(self, name: str) -> bool:
        return sum(name in pair for pair in self.untested) >= len(self.rows) - 1


def bar_panels(table: pd.DataFrame, tests: pd.DataFrame, by: tuple[str, str]) -> list[list[BarPanel | None]]:
    """Returns rows of panels, all of one length; None for what is left over of the last row.

    Args:
        table: `by`, teacher, mean, whisker and doubt.
        tests: `by`, first, second and p.
        by: columns that make rows and columns; rows are wrapped if there is a single column.
    """
    rows, columns = (sorted(table[column].unique(), key=functools.partial(order, column)) for column in by)
    panels = [[_panel(table, tests, by, (row, column)) for column in columns] for row in rows]
    if len(columns) > 1:
        return [list(line) for line in panels]
    found: list[BarPanel | None] = [panel for (panel,) in panels]
    found += [None] * (-len(found) % COLUMNS if len(found) > COLUMNS else 0)
    return [found[start : start + COLUMNS] for start in range(0, len(found), COLUMNS)]


def _panel(
    table: pd.DataFrame, tests: pd.DataFrame, by: tuple[str, str], place: tuple[object, object]
) -> BarPanel:
    rows = _at(table, by, place).set_index("teacher")[["mean", "whisker", "doubt"]]
    here = _at(tests, by, place)
    here = here[here["first"].isin(rows.index) & here["second"].isin(rows.index)]
    tested = {frozenset(pair) for pair in _pairs(here[here["p"].notna()])}
    untested = [
        pair for pair in itertools.combinations(sorted(rows.index), 2) if frozenset(pair) not in tested
    ]
    titles = title(by[0], place[0]), title(by[1], place[1])
    return BarPanel(titles, rows, _pairs(significant(here)), untested)


def _at(frame: pd.DataFrame, by: tuple[str, str], place: tuple[object, object]) -> pd.DataFrame:
    """Returns the rows of one panel; element by element, since pools are tuples in some tables."""
    here = [values == place for values in frame[list(by)].itertuples(index=False, name=None)]
    return frame[np.array(here, dtype=bool)]


def _pairs(tests: pd.DataFrame) -> list[Pair]:
    return list(tests[["first", "second"]].itertuples(index=False, name=None))


MOST_BRACKETS = 12
"""With more significant pairs in a panel than this, letters take the place of brackets."""

LANE = 0.055
"""Width of a lane of brackets or letters, over the length of the axis."""


DOUBT = "\N{DAGGER}"
"""Mark of a result that may be a slip of who published it."""


class Whisker(StrEnum):
    """What whiskers show."""

    DEVIATION = "standard deviation"
    ERROR = "standard error"


@styled
def bars_with_pairs(
    table: pd.DataFrame,
    tests: pd.DataFrame,
    measure: str = "mastered_percent",
    name: str = "Mastered test tasks (%)",
    whisker: Whisker = Whisker.DEVIATION,
    by: tuple[str, str] = ("challenge", "expert_knowledge"),
) -> Figure:
    """Draws mean results as bars, a row of panels per challenge and a column per level of expert knowledge.

    Pairs of teachers that differ significantly are joined by brackets. Eight teachers make 28 pairs, most of
    them significant in the paper: so many brackets cannot be told apart at the width of a page. If any panel
    has over `MOST_BRACKETS`, letters say the same in all panels, in a few columns and without loss: two
    teachers share a letter exactly if they do not differ significantly. A dashed line is Random's mean; a
    dash stands where a teacher has no result.

    Args:
        table: of `pooling.pooled` or `published.paper_frame`, with n.
        tests: all pairs, of `pairwise.pairwise` or `pairwise_statistics.pairwise_from_statistics`.
        measure: what is drawn.
        name: what that is, with its unit.
        whisker: standard deviation, or standard error of the mean.
        by: columns of both tables that make rows and columns of panels.

    Raises:
        ValueError: nothing to draw, or several results of a teacher in one panel.
    """
    whisker = Whisker(whisker)
    table = _table(table, measure, whisker, by)
    teachers = sorted(table["teacher"].unique(), key=teacher_order)
    rows = bar_panels(table, tests, by)
    figure, grid = _grid(rows, len(teachers))
    shown = [(axes, panel) for axes, panel in zip(grid.ravel(), itertools.chain(*rows), strict=True) if panel]
    brackets = max(len(panel.different) for _, panel in shown) <= MOST_BRACKETS
    start, end = _limits(table, measure)
    lane, used = LANE * (end - start), 0
    for axes, panel in shown:
        _draw_bars(axes, panel, teachers)
        used = max(used, (_draw_brackets if brackets else _draw_letters)(axes, panel, teachers, end, lane))
    axes = grid[0, 0]
    axes.set_xlim(start, end + lane * (used + 0.5 if used else 0))
    axes.set_xticks([tick for tick in MaxNLocator(4).tick_values(start, end) if start <= tick <= end])
    axes.set_ylim(len(teachers) - 0.4, -0.6)
    names = short_labels(teachers)
    axes.set_yticks(range(len(teachers)), [names[teacher] for teacher in teachers])
    notes = [f"{name}; whiskers: one {whisker.value}", *_notes([panel for _, panel in shown], brackets)]
    wide = int(figure.get_figwidth() * 17)
    caption = "\n".join(line for note in notes for line in textwrap.wrap(note, wide))
    figure.supxlabel(caption, fontsize=7, x=0.02, ha="left", linespacing=1.35)
    return figure


def _table(table: pd.DataFrame, measure: str, whisker: Whisker, by: tuple[str, str]) -> pd.DataFrame:
    """Returns `by`, teacher, mean, whisker (0 where there is none) and doubt (empty where there is none)."""
    mean, std = f"{measure}_mean", f"{measure}_std"
    require(table, [*by, "teacher", "n", mean, std], "results")
    table = table[table[mean].notna()]
    require(table, [], f"results with {mean}")
    require_unique(table, [*by, "teacher"], "results")
    error = table[std] / (np.sqrt(table["n"]) if whisker is Whisker.ERROR else 1.0)
    doubt = table["doubt"].fillna("") if "doubt" in table else ""
    columns = {"mean": table[mean].astype(float), "whisker": error.fillna(0.0), "doubt": doubt}
    return table[[*by, "teacher"]].assign(**columns)


def _grid(rows: Sequence[Sequence[BarPanel | None]], teachers: int) -> tuple[Figure, np.ndarray]:
    """Returns a figure with headed panels that share their axes."""
    lines, columns = len(rows), len(rows[0])
    width = TWO_COLUMNS if columns > 1 else ONE_COLUMN
    figure = Figure(figsize=(width, max(1.7, 0.7 + (0.3 + 0.135 * teachers) * lines)), layout="constrained")
    grid = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False)
    headings = {panel.titles[1] for row in rows for panel in row if panel}
    for line, row in enumerate(rows):
        for column, (axes, panel) in enumerate(zip(grid[line], row, strict=True)):
            if panel is None:
                axes.remove()
                grid[line - 1, column].tick_params(labelbottom=True)
                continue
            axes.tick_params(labelsize=6.5)
            axes.tick_params(axis="y", length=0)
            axes.grid(axis="x")
            if len(headings) == 1:
                axes.set_title(textwrap.fill(panel.titles[0], 30), fontsize=7)
            elif line == 0:
                axes.set_title(panel.titles[1], fontsize=7)
        if len(headings) > 1 and row[0]:
            grid[line, 0].set_ylabel(textwrap.fill(row[0].titles[0], 18), fontsize=7, fontweight="bold")
    if len(headings) == 1:
        figure.suptitle(headings.pop(), fontsize=7.5)
    return figure, grid


def _limits(table: pd.DataFrame, measure: str) -> tuple[float, float]:
    """Returns where the axis of values starts and ends: no whisker of a percentage goes below 0."""
    low = 0.0 if measure.endswith("percent") else min(0.0, (table["mean"] - table["whisker"]).min())
    high = max(
        (table["mean"] + table["whisker"]).max(), LEAST_PERCENT if measure.endswith("percent") else 0.0
    )
    return 1.02 * low, 1.02 * high if high > low else low + 1.0


def _draw_bars(axes: Axes, panel: BarPanel, teachers: Sequence[str]) -> None:
    if panel.rows.empty:
        remark(axes, "no results")
        return
    for place, teacher in enumerate(teachers):
        if teacher not in panel.rows.index:
            axes.text(
                0.01, place, "\N{EN DASH}", transform=axes.get_yaxis_transform(), color=MUTED, va="center"
            )
            continue
        mean, whisker = (float(panel.rows[name][teacher]) for name in ("mean", "whisker"))
        axes.barh(place, mean, height=0.7, color=look(teacher).colour, alpha=0.75)
        if whisker > 0:
            axes.errorbar(mean, place, xerr=whisker, color=INK, capsize=1.5, linewidth=0.7, capthick=0.7)
        if panel.rows["doubt"][teacher]:
            place_of: dict[str, Any] = {
                "xytext": (2, 0),
                "textcoords": "offset points",
                "va": "center",
                "fontsize": 7,
            }
            axes.annotate(DOUBT, (mean + whisker, place), gid=f"doubt-{teacher}", **place_of)
        if is_baseline(teacher):
            axes.axvline(mean, color=look(teacher).colour, linestyle=(0, (3, 2)), linewidth=0.7, zorder=0.5)


def _draw_brackets(axes: Axes, panel: BarPanel, teachers: Sequence[str], end: float, lane: float) -> int:
    """Joins the teachers that differ, right of `end`, and returns how many lanes that took."""
    places = {teacher: place for place, teacher in enumerate(teachers)}
    spans = lanes({(min(s), max(s)) for s in ((places[a], places[b]) for a, b in panel.different)})
    for (low, high), number in spans.items():
        right = end + lane * (number + 0.75)
        left, inset = right - 0.45 * lane, 0.16
        axes.plot(
            [left, right, right, left],
            [low + inset, low + inset, high - inset, high - inset],
            color=INK,
            linewidth=0.7,
            gid=f"{teachers[low]} differs from {teachers[high]}",
        )
    return max(spans.values(), default=-1) + 1


def _draw_letters(axes: Axes, panel: BarPanel, teachers: Sequence[str], end: float, lane: float) -> int:
    """Writes the letters of each teacher right of `end`, and returns in how many columns."""
    letters = panel.letters()
    for place, teacher in enumerate(teachers):
        for column, letter in enumerate(letters.get(teacher, "")):
            if letter != " ":
                x = end + lane * (column + 0.6)
                axes.text(x, place, letter, fontsize=6.5, ha="center", va="center")
    return max(map(len, letters.values()), default=0)


def _notes(panels: Sequence[BarPanel], brackets: bool) -> list[str]:
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
