"""First part of a report: the answer over all challenges, and the differences from Random on each one."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from analysis.charts.intervals import difference_chart
from analysis.charts.page import PageChart, on_page
from analysis.comparisons.against_random import Gap
from analysis.comparisons.budgets import compare_budgets
from analysis.comparisons.leaderboards import Leaderboard, leaderboards, notes
from analysis.comparisons.verdicts import AXES, Verdict
from analysis.data.frames import Frames
from analysis.formatting import number
from analysis.measures.tested import FINAL, HEADLINE
from analysis.names import short_title

CELL_AXES = (FINAL, HEADLINE)  # axes in the order of a cell

MOST_ROWS = 8  # largest number of rows of the chart, so that the matrix also fits on the screen


class DifferenceCell(NamedTuple):
    """Difference from Random in a cell: text, CSS class of its colour, and details shown on hover."""

    text: str
    decided: str
    details: str


class Row(NamedTuple):
    """Differences between a teacher and Random on both axes, over all challenges and on each one."""

    teacher: str
    name: str
    cells: list[list[DifferenceCell]]


@dataclass(frozen=True)
class Answer:
    """Leaderboard at the top of a page."""

    title: str  # level, budget and engine
    sentence: str  # answer on the best teachers
    chart: PageChart  # differences from Random over all challenges
    challenges: list[str]  # heads of the columns of challenges
    rows: list[Row]  # teachers, the best at the end first
    notes: list[str]  # meanings of the marks of teachers


def answers(frames: Frames) -> Iterator[Answer]:
    """Yield an answer for each level and budget that has several challenges and Random."""
    for count, board in enumerate(leaderboards(frames), start=1):
        compared = [entry.against for entry in board.entries if entry.against]
        if len(board.challenges) > 1 and compared:
            best = f", the best {MOST_ROWS} in the end" if len(compared) > MOST_ROWS else ""
            heading = f"Over all challenges{best}"
            budgets = compare_budgets(frames, board.runs)
            chart = difference_chart(compared[:MOST_ROWS], board.names, heading, f"answer-{count}")
            yield Answer(
                title=f"{board.title[0].upper()}{board.title[1:]}",
                sentence=board.answer(),
                chart=on_page(chart),
                challenges=[short_title(title) for title in board.challenges],
                rows=list(_rows(board)),
                notes=[*notes(board), *([budgets.sentence()] if budgets else [])],
            )


def _rows(board: Leaderboard) -> Iterator[Row]:
    on_each = {axis: board.on_each_challenge(axis) for axis in CELL_AXES}
    for entry in board.entries:
        if entry.against is None:
            continue
        over_all = [_difference(axis, entry.against.gaps[axis]) for axis in CELL_AXES]
        cells = [
            [_difference(axis, on_each[axis].get((entry.teacher, title))) for axis in CELL_AXES]
            for title in board.challenges
        ]
        yield Row(entry.teacher, board.marked(entry), [over_all, *cells])


def _difference(axis: str, gap: Gap | None) -> DifferenceCell:
    if gap is None or math.isnan(gap.value):
        return DifferenceCell("\N{EN DASH}", "", "")
    decided = gap.verdict if gap.verdict in (Verdict.BETTER, Verdict.WORSE) else ""
    return DifferenceCell(number(gap.value), decided, f"{AXES[axis]}: {gap}, {gap.verdict}")
