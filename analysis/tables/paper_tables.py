"""The paper's tables: results of runs or published ones, hyper-parameters, expert knowledge."""

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from analysis.data.columns import TABLE_CONDITIONS
from analysis.data.frames import Frames
from analysis.data.reference import paper_frame
from analysis.formatting import amount
from analysis.measures import pooling
from analysis.measures.evaluations import SEARCH_COLUMNS
from analysis.measures.run_measures import run_measures
from analysis.names import label, teacher_order
from analysis.tables.table import Cell, Table, with_best
from tma_ray import benchmark
from tma_ray.results import CHIPMUNK
from tma_ray.tasks import MASTERY_RETURN, KnowledgeLevel

RESULTS = [
    *("environment", "challenge", "expert_knowledge", "embodiments", "students", "teacher"),
    *("n", "mean", "std", "digits", "missing", "doubt"),
]
"""Columns of results: embodiments and students are sorted tuples of those pooled, mean and std are of
mastered tasks in per cent, digits the decimals that count, missing and doubt as in `table.Cell`."""


@dataclass(frozen=True)
class TableResults:
    """Results that can share a table.

    Attributes:
        rows: one result each, with the columns `RESULTS`.
        matrices: bodies and students of each challenge.
        name: part of file names that distinguishes results of the same place; empty for the first.
        remark: sentence on the runs behind them.
    """

    rows: pd.DataFrame
    matrices: tuple[benchmark.Matrix, ...] = benchmark.MATRICES
    name: str = ""
    remark: str = ""


def published_table_results(frame: pd.DataFrame | None = None) -> TableResults:
    """Return published results, those of the paper by default.

    Args:
        frame: table with the columns of `paper_frame`.
    """
    frame = paper_frame() if frame is None else frame
    steps = " or ".join(amount(steps) for steps in sorted(frame["steps"].unique()))
    engines = " and ".join(sorted(frame["engine"].unique()))
    remark = f"As published, after {steps} steps in worlds of {engines}: to be set beside ours, never pooled."
    return TableResults(results_of(frame), remark=remark)


def table_results(frames: Frames, step: int | None = None) -> list[TableResults]:
    """Return the results of a root, split into groups that can share a table.

    Results of students that the paper does not have in a challenge, such as PPO everywhere, stand apart from
    those that pool the paper's. Points of searches for hyper-parameters are left out.

    Args:
        frames: result of `load`.
        step: step at which runs are read; None for their ends.
    """
    cells, values = pooling.without_searches(frames.cells), run_measures(frames, step)
    found: list[TableResults] = []
    for name, matrices, chosen in pooling.by_students(cells):
        runs = pooling.reuse_random(pooling.pool_runs(chosen, values, matrices))
        both = pd.concat([pooling.pooled(runs), pooling.pooled(runs, by=["embodiment"])], ignore_index=True)
        for remark, rows in _apart(both, step):
            tag = "-".join(filter(None, [name, str(len(found) + 1) if found else ""]))
            found.append(TableResults(results_of(rows), matrices, tag, remark))
    return found


def results_of(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the columns `RESULTS` of pooled results or of published ones.

    Args:
        frame: results of `pooling.pooled`, some by embodiment or not, or of `reference.paper_frame`.
    """
    found = frame.rename(columns={"mastered_percent_mean": "mean", "mastered_percent_std": "std"})
    if "pool" in found:
        parts = [pooling.parts_of(pool) for pool in found["pool"]]
        alone = found["embodiment"] if "embodiment" in found else [None] * len(found)
        bodies = [
            {body} if isinstance(body, str) else {each for each, _ in part}
            for body, part in zip(alone, parts, strict=True)
        ]
        students = [{student for _, student in part} for part in parts]
        digits = [1] * len(found)
    else:
        bodies, students = list(found["embodiments"].map(set)), list(found["students"].map(set))
        digits = [1 if round(mean, 1) == mean else 2 for mean in found["mean"]]
    found = found.assign(
        digits=digits,
        embodiments=pd.Series([tuple(sorted(each)) for each in bodies], index=found.index, dtype=object),
        students=pd.Series([tuple(sorted(each)) for each in students], index=found.index, dtype=object),
        **{name: "" for name in ("missing", "doubt") if name not in found},
    )
    # A pool of one body is there twice: whole, and by body.
    key = RESULTS[:6]
    return found[RESULTS].drop_duplicates(key).sort_values(key, ignore_index=True)


def _apart(frame: pd.DataFrame, step: int | None) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield groups of results with the same settings, each with a remark."""
    shipped = pooling.shipped_together(frame["environment"].unique())
    places = frame[["engine", "environment", "challenge"]].itertuples(index=False, name=None)
    own = [
        "" if pd.isna(each) or each == pooling.PLUS.join(shipped.get(place, ())) else each
        for place, each in zip(places, frame["test_sets"], strict=True)
    ]
    frame = frame.assign(test_set=own)
    for column in TABLE_CONDITIONS[:-1]:
        known = frame[column].dropna().unique()
        frame[column] = frame[column].fillna(known[0]) if len(known) == 1 else frame[column]
    groups = list(frame.groupby(TABLE_CONDITIONS, dropna=False, sort=True))
    key: Any
    for key, rows in sorted(groups, key=lambda group: -len(group[1])):
        budget, engine, physics, threshold, test_set = key
        if pd.isna(budget):
            yield "Nothing has begun.", rows
            continue
        worlds = f"physics version {physics:g}" if engine == CHIPMUNK else f"worlds of {engine}"
        text = f"After {amount(budget if step is None else step)} steps, {worlds}"
        if threshold != MASTERY_RETURN:
            text += f", tasks mastered over a return of {threshold:g}"
        yield f"{text}, test set {test_set}." if test_set else f"{text}.", rows


MASTERED = "mastered test tasks in per cent, mean ± standard deviation over runs"

OVERALL = "overall"

_LEVELS = {"none": "No expert knowledge", "low": "Low", "high": "High"}


def result_tables(results: TableResults) -> list[Table]:
    """Return every table of results with at least one requested cell, in the paper's order.

    The original task space of Stump Tracks has a column for each level of expert knowledge, its challenges a
    table for each level, and Parkour, which has one level, a column for each body and one over all of them.
    """
    mine = {matrix.name: matrix for matrix in results.matrices}  # perhaps with other students
    original = mine[benchmark.ORIGINAL_SPACE.name]
    wanted = {level: (original, original.embodiments, level) for level in _LEVELS}
    heading = f"Stump Tracks, original task space: {MASTERED}"
    tables = [_table(results, "original_space", heading, _LEVELS, wanted)]
    matrices = {matrix.challenge: mine[matrix.name] for matrix in benchmark.STUMP_TRACKS_CHALLENGES}
    columns = {name: benchmark.find_challenge("stump_tracks", name).title for name in matrices}
    for level in KnowledgeLevel:
        wanted = {name: (matrix, matrix.embodiments, level.value) for name, matrix in matrices.items()}
        heading = f"Challenges of Stump Tracks, expert knowledge {level.value}: {MASTERED}"
        tables.append(_table(results, f"challenges_{level.value}", heading, columns, wanted))
    bodies = {matrix.embodiments[0]: mine[matrix.name] for matrix in benchmark.PARKOUR}
    any_body = next(iter(bodies.values()))
    (level,) = any_body.levels
    columns = {body: body.replace("_", " ").capitalize() for body in bodies} | {OVERALL: "Overall"}
    wanted = {body: (matrix, (body,), level.value) for body, matrix in bodies.items()}
    wanted[OVERALL] = (any_body, tuple(bodies), level.value)
    heading = f"Parkour, expert knowledge {level.value}: {MASTERED}"
    tables.append(_table(results, "parkour", heading, columns, wanted))
    return [table for table in tables if table.rows]


def hyperparameters(found: pd.DataFrame | None = None) -> Table:
    """Return searched hyper-parameters: values tried, the paper's choice, the best point found.

    Args:
        found: result of `search_results`; None where nothing was searched.
    """
    found = pd.DataFrame(columns=SEARCH_COLUMNS) if found is None else found
    columns = {"values": "Values tried", "chosen": "The paper's choice", "found": "Best found"}
    rows: dict[str, str] = {}
    cells: dict[tuple[str, str], Cell] = {}
    for teacher in sorted(benchmark.TEACHER_GRIDS, key=teacher_order):
        grid, points = benchmark.TEACHER_GRIDS[teacher], found[found["searched"] == teacher]
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
    """Return the expert knowledge that each teacher requires, can use and ignores."""
    columns = {
        "initial_distribution": "Initial distribution",
        "target_distribution": "Target distribution",
        "mastery_range": "Reward mastery range",
    }
    teachers = sorted(benchmark.KNOWLEDGE_REQUIREMENTS, key=teacher_order)
    cells = {
        (teacher, column): Cell(words=getattr(benchmark.KNOWLEDGE_REQUIREMENTS[teacher], column).value)
        for teacher in teachers
        for column in columns
    }
    rows = {teacher: label(teacher) for teacher in teachers}
    return Table("expert_knowledge", "Expert knowledge that teachers use", "Teacher", rows, columns, cells)


def _table(
    results: TableResults,
    name: str,
    title: str,
    columns: Mapping[str, str],
    wanted: Mapping[str, tuple[benchmark.Matrix, tuple[str, ...], str]],
) -> Table:
    """Return a table of teachers, whose columns show a matrix, its bodies and a level."""
    rows, found = results.rows, dict[tuple[str, str], Cell]()
    for column, (matrix, bodies, level) in wanted.items():
        here = (
            (rows["environment"] == matrix.environment)
            & (rows["challenge"] == matrix.challenge)
            & (rows["expert_knowledge"] == level)
            & rows["embodiments"].map(lambda pool, bodies=bodies: pool == tuple(sorted(bodies)))
            & rows["students"].map(lambda pool, matrix=matrix: pool == tuple(sorted(matrix.students)))
        )
        found |= {(str(row["teacher"]), column): _number(row) for _, row in rows[here].iterrows()}
    teachers = sorted({teacher for teacher, _ in found}, key=teacher_order)
    for teacher, (column, (_, _, level)) in itertools.product(teachers, wanted.items()):
        needs = benchmark.KNOWLEDGE_REQUIREMENTS.get(teacher)
        required = needs is not None and needs.mastery_range is benchmark.Requirement.REQUIRED
        refused = required and level == KnowledgeLevel.NONE
        reason = "cannot run without the reward mastery range" if refused else "not run"
        found.setdefault((teacher, column), Cell(missing=reason))
    name = f"{name}-{results.name}" if results.name else name
    labels = {teacher: label(teacher) for teacher in teachers}
    remarks = (results.remark,) if results.remark else ()
    return with_best(Table(name, title, "Teacher", labels, columns, found, remarks))


def _number(row: pd.Series) -> Cell:
    numbers: dict[str, Any] = {name: row[name] for name in ("n", "mean", "std")}
    others = {name: row[name] for name in ("digits", "missing", "doubt") if name in row}
    return Cell(**(numbers | others))


def _plain(value: object) -> str:
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:g}" if isinstance(value, float) else str(value)
