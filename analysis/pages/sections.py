"""Sections of a report: answers over all challenges, and each comparison's text, table and charts."""

import math
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import pandas as pd
from numpy.typing import NDArray

from analysis.charts.catalogue import page_charts, page_panels, page_pictures, points_of
from analysis.charts.intervals import difference_chart, overview_chart
from analysis.charts.page import PageChart, on_page
from analysis.charts.paper import Picture, draw
from analysis.comparisons.against_random import Gap
from analysis.comparisons.budgets import compare_budgets
from analysis.comparisons.comparison import Measurements, TeacherComparison
from analysis.comparisons.leaderboards import Leaderboard, leaderboards, notes
from analysis.comparisons.pairwise import along_baseline
from analysis.comparisons.sentences import findings
from analysis.data.columns import FILTERS
from analysis.data.frames import Frames
from analysis.data.reference import is_baseline
from analysis.formatting import few_seeds_warning, number, p_value, plus_minus, steps_text
from analysis.measures.tested import AXES, FINAL, HEADLINE, Verdict, on_both_axes, verdict
from analysis.names import short_title, teacher_order
from analysis.statistics import describe

CELL_AXES = (FINAL, HEADLINE)  # measures, in the order in which a cell shows them

MOST_ROWS = 8  # maximum number of rows of the chart, to leave room on the screen for the matrix below


class DifferenceCell(NamedTuple):
    """Cell with a difference from Random: text, CSS class of its colour, and details shown on hover."""

    text: str
    decided: str
    details: str


class Row(NamedTuple):
    """Row with a teacher's differences from Random in both measures, over all challenges and on each."""

    teacher: str
    name: str
    cells: list[list[DifferenceCell]]


@dataclass(frozen=True)
class Answer:
    """Leaderboard at the top of a report: sentence, chart and matrix."""

    title: str  # level, budget and engine
    sentence: str  # sentence about the best teachers
    chart: PageChart  # differences from Random over all challenges
    columns: list[str]  # column headings: all challenges (or bodies) together, then one by one
    rows: list[Row]  # one row per teacher, with the best final results first
    notes: list[str]  # notes below the matrix


def answers(frames: Frames) -> Iterator[Answer]:
    """Yield an answer for each leaderboard that has results of Random and several challenges or bodies."""
    for count, board in enumerate(leaderboards(frames), start=1):
        compared = [entry.against for entry in board.entries if entry.against]
        if len(board.columns) > 1 and compared:
            best = f", the best {MOST_ROWS} in the end" if len(compared) > MOST_ROWS else ""
            whole = "all bodies" if board.bodies else "all challenges"
            heading = f"Over {whole}{best}"
            budgets = compare_budgets(frames, board.runs)
            chart = difference_chart(compared[:MOST_ROWS], board.names, heading, f"answer-{count}")
            yield Answer(
                title=f"{board.title[0].upper()}{board.title[1:]}",
                sentence=board.answer(),
                chart=on_page(chart),
                columns=[whole.capitalize(), *map(short_title, board.bodies or board.challenges)],
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
            for title in board.bodies or board.challenges
        ]
        yield Row(entry.teacher, board.marked(entry), [over_all, *cells])


def _difference(axis: str, gap: Gap | None) -> DifferenceCell:
    if gap is None or math.isnan(gap.value):
        return DifferenceCell("\N{EN DASH}", "", "")
    decided = gap.verdict if gap.verdict in (Verdict.BETTER, Verdict.WORSE) else ""
    return DifferenceCell(number(gap.value), decided, f"{AXES[axis]}: {gap}, {gap.verdict}")


@dataclass(frozen=True, eq=False)
class Section:
    """Section of a page: one comparison with its table, charts and figures."""

    anchor: str  # identifier on the page
    title: str  # title of the comparison
    chosen_by: Mapping[str, str]  # values that the page's filters match, by column of `FILTERS`
    rows: Sequence[Mapping[str, Any]]  # rows of the table of final results, one per teacher
    step_rows: Mapping[str, Mapping[str, Mapping[str, str]]]  # table cells by step, teacher, column
    points: pd.DataFrame  # teacher, seed, step (or `END`) and value, a row per run and evaluation
    charts: Sequence[PageChart]  # charts with all teachers
    sentences: Sequence[str] = ()  # sentences about the findings
    panels: Sequence[PageChart] = ()  # charts with a panel per teacher
    pictures: Sequence[Picture] = ()  # static figures


def overview(
    sections: Sequence[Section], titles: Iterable[str], quantity: str, heading: str, caption: str
) -> list[PageChart]:
    """Return the overview chart of all comparisons, empty for fewer than two or without results."""
    points = [section.points.assign(comparison=section.anchor) for section in sections]
    if len(sections) < 2 or all(table.empty for table in points):
        return []
    table = pd.concat(points, ignore_index=True)
    fewest = table.groupby(["comparison", "teacher"])["seed"].nunique().min()
    rows = dict(zip((section.anchor for section in sections), titles, strict=True))
    caption = " ".join(filter(None, [caption, few_seeds_warning(fewest)]))
    return [on_page(overview_chart(table, rows, quantity, heading, caption))]


def end_rows(comparison: TeacherComparison) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table of final results, one per teacher in `teacher_order`."""
    tests = {axis: comparison.tests[comparison.tests["measure"] == axis] for axis in AXES}
    groups: dict[str, Any] = {str(group["teacher"]): group for group in comparison.summary.to_dict("records")}
    tested = {axis: table.set_index("teacher").to_dict("index") for axis, table in tests.items()}
    worst = comparison.finals.groupby("teacher")[HEADLINE].min()
    for teacher in sorted(groups, key=teacher_order):
        group = groups[teacher]
        step = steps_text(group["step"]) if group["n"] else "\N{EN DASH}"
        yield {
            "name": teacher,
            "mean": float(group[f"{HEADLINE}_mean"]),
            "seeds": f"{group['n']}" if group["n"] == group["seeds"] else f"{group['n']} of {group['seeds']}",
            "step": step + "*" * bool(group["provisional"]),
            "mastered": plus_minus(group[f"{HEADLINE}_mean"], group[f"{HEADLINE}_std"]),
            "final": plus_minus(group[f"{FINAL}_mean"], group[f"{FINAL}_std"]),
            "worst": number(worst.get(teacher, math.nan)),
            "evaluation": plus_minus(group["evaluation_return_mean"], group["evaluation_return_std"]),
            "training": f"{number(group['first_quarter_mean'])} → {number(group['last_quarter_mean'])}",
            "provisional": group["provisional"],
            "verdict": "baseline" if is_baseline(teacher) else "not evaluated yet",
            **_against_random(tested, teacher),
        }


def best_of(section: Section) -> Mapping[str, Any] | None:
    """Return the row of the best teacher over training, or None if no run has ended or mastered a task."""
    ended = [row for row in section.rows if row["mean"] > 0 and not row["provisional"]]
    return max(ended, key=lambda row: row["mean"], default=None)


def step_rows(comparison: TeacherComparison) -> dict[str, dict[str, dict[str, str]]]:
    """Return the formatted table cells at every evaluation, by step, teacher and column."""
    curves = comparison.evaluations
    if curves.empty:
        return {}
    tests = {axis: along_baseline(curves, comparison.reference, axis) for axis in AXES}
    tested = {axis: table.set_index(["step", "teacher"]).to_dict("index") for axis, table in tests.items()}

    columns = {"mastered": HEADLINE, "final": FINAL, "evaluation": "evaluation_return"}

    def row(step: int, teacher: str, rows: Columns) -> dict[str, str]:
        samples = {name: describe(rows[column]) for name, column in columns.items()}
        return {
            "seeds": str(len(set(rows["run_id"]))),
            "step": steps_text(step),
            "worst": number(rows[HEADLINE].min()),
            "training": "",
            "verdict": "baseline" if is_baseline(teacher) else "",
            **{name: plus_minus(sample.mean, sample.std) for name, sample in samples.items()},
            **_against_random(tested, (step, teacher)),
        }

    return by_step(curves[["step", "teacher", "run_id", *columns.values()]], row)


Columns: TypeAlias = Mapping[str, NDArray[Any]]  # columns of a table, by name


def by_step(
    curves: pd.DataFrame, row: Callable[[int, str, Columns], dict[str, str]]
) -> dict[str, dict[str, dict[str, str]]]:
    """Return the table rows by step and teacher, computed by `row` from a teacher's runs at a step."""
    texts: dict[str, dict[str, dict[str, str]]] = {}
    columns = {str(name): curves[name].to_numpy() for name in curves}
    groups: dict[Any, Any] = curves.groupby(["step", "teacher"]).indices
    for step, teacher in sorted(groups):
        rows = {name: values[groups[step, teacher]] for name, values in columns.items()}
        texts.setdefault(str(int(step)), {})[str(teacher)] = row(int(step), str(teacher), rows)
    return texts


def _against_random(tested: Mapping[str, Mapping[Any, Mapping[Any, Any]]], key: Hashable) -> dict[str, str]:
    """Return the table cells for the tests of `key` in both measures, empty where there is no test."""
    tests = {axis: rows[key] for axis, rows in tested.items() if key in rows}
    if len(tests) < len(tested):
        return {"difference": "", "p": ""}
    test = tests[HEADLINE]
    words = on_both_axes(verdict(test), verdict(tests[FINAL]))
    if test["reason"]:
        return {"verdict": words, "difference": number(test["difference"]), "p": ""}
    p = p_value(test["holm"]).removeprefix("p").removeprefix(" = ").strip()
    return {"verdict": words, "difference": str(Gap.of(test)), "p": p}


def sections(measurements: Measurements) -> Iterator[Section]:
    """Yield a section for each comparison of a root, in a fixed order."""
    for comparison in measurements.comparisons:
        first = comparison.cells.iloc[0]
        yield Section(
            anchor=comparison.anchor,
            title=comparison.title,
            chosen_by={column: str(first[column]) for column in FILTERS},
            sentences=findings(comparison.summary, comparison.tests),
            rows=list(end_rows(comparison)),
            step_rows=step_rows(comparison),
            points=points_of(comparison.evaluations, comparison.finals, HEADLINE),
            charts=list(map(on_page, page_charts(comparison))),
            panels=list(map(on_page, page_panels(comparison))),
            pictures=[
                Picture.of(chart.name, draw(chart), chart.title, chart.caption)
                for chart in page_pictures(comparison)
            ],
        )


def distinct(titles: Sequence[str]) -> list[str]:
    """Return `titles` without the comma-separated parts that all of them have in common."""
    parts = [title.split(", ") for title in titles]
    shared = set.intersection(*map(set, parts)) if parts else set()
    return [", ".join(part for part in title if part not in shared) or ", ".join(title) for title in parts]
