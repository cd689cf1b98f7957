"""The beginning of a report: the answer over all challenges, and the differences to Random on each."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from analysis.charts.intervals import difference_chart
from analysis.charts.page import PageChart, on_page
from analysis.comparisons.against_random import Gap
from analysis.comparisons.boards import Leaderboard, leaderboards, notes
from analysis.comparisons.verdicts import AXES, Verdict
from analysis.data.frames import Frames
from analysis.formatting import number
from analysis.measures.tested import FINAL, HEADLINE
from analysis.names import short_title

SHOWN = (FINAL, HEADLINE)
"""Axes in the order of a cell."""


MOST = 8
"""Rows of the chart, so that a screen has the matrix, too."""


class Difference(NamedTuple):
    """A difference to Random in a cell: text, class of its colour, and details under the mouse."""

    text: str
    decided: str
    details: str


class Row(NamedTuple):
    """Differences of a teacher to Random, over all challenges and on each, on both axes."""

    teacher: str
    name: str
    cells: list[list[Difference]]


@dataclass(frozen=True)
class Answer:
    """A leaderboard as a page begins with it.

    Attributes:
        title: level, budget and engine.
        sentence: answer on the best teachers.
        chart: differences to Random over all challenges.
        challenges: heads of the columns, but that over all challenges.
        rows: teachers, the best in the end first.
        notes: what the marks of teachers mean.
    """

    title: str
    sentence: str
    chart: PageChart
    challenges: list[str]
    rows: list[Row]
    notes: list[str]


def answers(frames: Frames) -> Iterator[Answer]:
    """Yield the answer at each level and budget that has several challenges and Random."""
    for count, board in enumerate(leaderboards(frames), start=1):
        beside = [entry.against for entry in board.entries if entry.against]
        if len(board.challenges) > 1 and beside:
            best = f", the best {MOST} in the end" if len(beside) > MOST else ""
            heading = f"Over all challenges{best}"
            chart = difference_chart(beside[:MOST], board.names, heading, f"answer-{count}")
            yield Answer(
                title=f"{board.title[0].upper()}{board.title[1:]}",
                sentence=board.answer(),
                chart=on_page(chart),
                challenges=[short_title(title) for title in board.challenges],
                rows=list(_rows(board)),
                notes=notes(board),
            )


def _rows(board: Leaderboard) -> Iterator[Row]:
    on_each = {axis: board.on_each_challenge(axis) for axis in SHOWN}
    for entry in board.entries:
        if entry.against is None:
            continue
        over_all = [_difference(axis, entry.against.gaps[axis]) for axis in SHOWN]
        cells = [
            [_difference(axis, on_each[axis].get((entry.teacher, title))) for axis in SHOWN]
            for title in board.challenges
        ]
        yield Row(entry.teacher, board.marked(entry), [over_all, *cells])


def _difference(axis: str, gap: Gap | None) -> Difference:
    if gap is None or math.isnan(gap.value):
        return Difference("\N{EN DASH}", "", "")
    decided = gap.verdict if gap.verdict in (Verdict.BETTER, Verdict.WORSE) else ""
    return Difference(number(gap.value), decided, f"{AXES[axis]}: {gap}, {gap.verdict}")
