"""The paper's tables: of what was run, of hyper-parameters, of what teachers need to be told."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import pandas as pd

from analysis.measures.searches import POINTS
from analysis.names import label, teacher_order
from analysis.tables.results import TableResults
from analysis.tables.table import Cell, Table, with_best
from tma_ray.benchmark import (
    KNOWLEDGE_REQUIREMENTS,
    ORIGINAL_SPACE,
    PARKOUR,
    STUMP_TRACKS_CHALLENGES,
    TEACHER_GRIDS,
    Matrix,
    Requirement,
    find_challenge,
)
from tma_ray.tasks import KnowledgeLevel

MASTERED = "mastered test tasks in per cent, mean ± standard deviation over runs"

OVERALL = "overall"

_LEVELS = {"none": "No expert knowledge", "low": "Low", "high": "High"}


def result_tables(results: TableResults) -> list[Table]:
    """Returns every table of results of which any cell was asked for, in the paper's order."""
    tables = [original_space(results), *(challenges(results, level) for level in KnowledgeLevel)]
    return [table for table in (*tables, parkour(results)) if table.rows]


def original_space(results: TableResults) -> Table:
    """Returns the original task space of Stump Tracks: teachers by levels of expert knowledge."""
    (matrix,) = _like([ORIGINAL_SPACE], results)
    title = f"Stump Tracks, original task space: {MASTERED}"
    wanted = {level: (matrix, matrix.embodiments, level) for level in _LEVELS}
    return _table(results, "original_space", title, _LEVELS, wanted)


def challenges(results: TableResults, level: KnowledgeLevel) -> Table:
    """Returns the five challenges of Stump Tracks at one level: teachers by challenges."""
    matrices = {matrix.challenge: matrix for matrix in _like(STUMP_TRACKS_CHALLENGES, results)}
    columns = {name: find_challenge("stump_tracks", name).title for name in matrices}
    title = f"Challenges of Stump Tracks, expert knowledge {level.value}: {MASTERED}"
    wanted = {name: (matrix, matrix.embodiments, level.value) for name, matrix in matrices.items()}
    return _table(results, f"challenges_{level.value}", title, columns, wanted)


def parkour(results: TableResults) -> Table:
    """Returns Parkour, which has one level: teachers by bodies, and over all of them."""
    matrices = {matrix.embodiments[0]: matrix for matrix in _like(PARKOUR, results)}
    (level,) = matrices[next(iter(matrices))].levels
    columns = {body: body.replace("_", " ").capitalize() for body in matrices} | {OVERALL: "Overall"}
    wanted: dict[str, tuple[Matrix, tuple[str, ...], str]] = {}
    wanted |= {body: (matrix, (body,), level.value) for body, matrix in matrices.items()}
    wanted[OVERALL] = (next(iter(matrices.values())), tuple(matrices), level.value)
    title = f"Parkour, expert knowledge {level.value}: {MASTERED}"
    return _table(results, "parkour", title, columns, wanted)


def hyperparameters(found: pd.DataFrame | None = None) -> Table:
    """Returns what was searched of each teacher: values tried, the paper's choice, the best point found.

    Args:
        found: of `search.search_results`; None where nothing was searched.
    """
    found = pd.DataFrame(columns=POINTS) if found is None else found
    columns = {"values": "Values tried", "chosen": "The paper's choice", "found": "Best found"}
    rows: dict[str, str] = {}
    cells: dict[tuple[str, str], Cell] = {}
    for teacher in sorted(TEACHER_GRIDS, key=teacher_order):
        grid, points = TEACHER_GRIDS[teacher], found[found["searched"] == teacher]
        best = points.iloc[0] if len(points) else None
        for name, values in grid.values.items():
            key = f"{teacher}.{name}"
            rows[key] = f"{label(teacher)}: {name}"
            cells[key, "values"] = Cell(words=", ".join(map(_plain, values)))
            cells[key, "chosen"] = Cell(words=_plain(grid.chosen[name]))
            unknown = Cell(missing="no point has been run to its end")
            cells[key, "found"] = unknown if best is None else Cell(words=_plain(best["point"][name]))
        if best is not None:
            key = f"{teacher}.mastered_percent"
            rows[key] = f"{label(teacher)}: mastered %"
            cells[key, "values"] = Cell(words=f"{len(points)} of {len(grid.points())} points run")
            theirs = points[points["chosen"]]
            cells[key, "chosen"] = (
                _number(theirs.iloc[0]) if len(theirs) else Cell(missing="not run to its end")
            )
            cells[key, "found"] = _number(best)
    title = "Hyper-parameters of the teachers"
    return Table("hyperparameters", title, "Hyper-parameter", rows, columns, cells)


def knowledge_needs() -> Table:
    """Returns what each teacher requires, can use and ignores of an expert's knowledge."""
    columns = {
        "initial_distribution": "Initial distribution",
        "target_distribution": "Target distribution",
        "mastery_range": "Reward mastery range",
    }
    teachers = sorted(KNOWLEDGE_REQUIREMENTS, key=teacher_order)
    cells = {
        (teacher, column): Cell(words=getattr(KNOWLEDGE_REQUIREMENTS[teacher], column).value)
        for teacher in teachers
        for column in columns
    }
    rows = {teacher: label(teacher) for teacher in teachers}
    return Table("expert_knowledge", "Expert knowledge that teachers use", "Teacher", rows, columns, cells)


def _like(wanted: list[Matrix] | tuple[Matrix, ...], results: TableResults) -> list[Matrix]:
    """Returns the matrices of `wanted` as `results` have them, perhaps with other students."""
    mine = {matrix.name: matrix for matrix in results.matrices}
    return [mine[matrix.name] for matrix in wanted]


def _table(
    results: TableResults,
    name: str,
    title: str,
    columns: Mapping[str, str],
    wanted: Mapping[str, tuple[Matrix, tuple[str, ...], str]],
) -> Table:
    """Returns a table of teachers, whose columns show a matrix, its bodies and a level."""
    found: dict[tuple[str, str], Cell] = {}
    for column, (matrix, bodies, level) in wanted.items():
        found |= {(teacher, column): cell for teacher, cell in _column(results.rows, matrix, bodies, level)}
    teachers = sorted({teacher for teacher, _ in found}, key=teacher_order)
    absent = {
        (teacher, column): Cell(missing=_absent(teacher, level))
        for teacher in teachers
        for column, (_, _, level) in wanted.items()
    }
    name = f"{name}-{results.name}" if results.name else name
    rows, remarks = {teacher: label(teacher) for teacher in teachers}, (results.remark,)
    table = Table(name, title, "Teacher", rows, columns, absent | found, remarks if results.remark else ())
    return with_best(table)


def _column(
    rows: pd.DataFrame, matrix: Matrix, bodies: tuple[str, ...], level: str
) -> Iterator[tuple[str, Cell]]:
    here = (
        (rows["environment"] == matrix.environment)
        & (rows["challenge"] == matrix.challenge)
        & (rows["expert_knowledge"] == level)
        & rows["embodiments"].map(lambda pool: pool == tuple(sorted(bodies)))
        & rows["students"].map(lambda pool: pool == tuple(sorted(matrix.students)))
    )
    yield from ((str(row["teacher"]), _number(row)) for _, row in rows[here].iterrows())


def _number(row: pd.Series) -> Cell:
    numbers: dict[str, Any] = {name: row[name] for name in ("n", "mean", "std")}
    others = {name: row[name] for name in ("digits", "missing", "doubt") if name in row}
    return Cell(**(numbers | others))


def _absent(teacher: str, level: str) -> str:
    """Returns why results are missing of `teacher` at `level`."""
    needs = KNOWLEDGE_REQUIREMENTS.get(teacher)
    if needs and needs.mastery_range is Requirement.REQUIRED and level == KnowledgeLevel.NONE:
        return "cannot run without the reward mastery range"
    return "not run"


def _plain(value: object) -> str:
    return (
        f"{value:,}" if isinstance(value, int) else f"{value:g}" if isinstance(value, float) else str(value)
    )
