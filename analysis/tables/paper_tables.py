"""The paper's tables: results, hyper-parameters, expert knowledge."""

import itertools
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from analysis.data.columns import TABLE_CONDITIONS
from analysis.data.frames import Frames
from analysis.data.reference import paper_frame
from analysis.formatting import steps_text
from analysis.measures import pooling
from analysis.measures.evaluations import SEARCH_COLUMNS
from analysis.measures.run_measures import run_measures
from analysis.names import label, teacher_order
from analysis.tables.table import ResultTable, TableCell, with_best
from tma_ray import benchmark
from tma_ray.results import CHIPMUNK
from tma_ray.tasks import MASTERY_RETURN, KnowledgeLevel

RESULTS = [
    *("environment", "challenge", "expert_knowledge", "embodiments", "students", "teacher"),
    *("n", "mean", "std", "digits", "missing", "doubt"),
]
"""Columns of results: embodiments and students are sorted tuples, mean and std are of mastered tasks in per
cent, and digits, missing and doubt as in `table.TableCell`."""


@dataclass(frozen=True)
class TableResults:
    """Results under the same settings, which can share a table.

    Attributes:
        rows: results, with the columns `RESULTS`.
        matrices: embodiments and students of each challenge.
        name: tag in file names; empty for the first results of a root.
        remark: sentence about the runs.
    """

    rows: pd.DataFrame
    matrices: tuple[benchmark.Matrix, ...] = benchmark.MATRICES
    name: str = ""
    remark: str = ""


def published_table_results(frame: pd.DataFrame | None = None) -> TableResults:
    """Return published results for tables, by default the paper's.

    Args:
        frame: table with the columns of `paper_frame`.
    """
    frame = paper_frame() if frame is None else frame
    steps = " or ".join(steps_text(steps) for steps in sorted(frame["steps"].unique()))
    engines = " and ".join(sorted(frame["engine"].unique()))
    remark = f"As published, after {steps} steps in worlds of {engines}: to be set beside ours, never pooled."
    return TableResults(results_of(frame), remark=remark)


def table_results(frames: Frames, step: int | None = None) -> list[TableResults]:
    """Return the results of a root in groups that can share a table, without hyper-parameter searches.

    Students that are not the paper's have groups of their own.

    Args:
        frames: result from `load`.
        step: step at which runs are measured; None for their ends.
    """
    cells, values = pooling.without_searches(frames.cells), run_measures(frames, step)
    groups: list[TableResults] = []
    for name, matrices, members in pooling.by_students(cells):
        runs = pooling.reuse_random(pooling.pool_runs(members, values, matrices))
        both = pd.concat([pooling.pooled(runs), pooling.pooled(runs, by=["embodiment"])], ignore_index=True)
        for remark, rows in _by_settings(both, step):
            tag = "-".join(filter(None, [name, str(len(groups) + 1) if groups else ""]))
            groups.append(TableResults(results_of(rows), matrices, tag, remark))
    return groups


def results_of(frame: pd.DataFrame) -> pd.DataFrame:
    """Convert pooled or published results to the columns `RESULTS`.

    Args:
        frame: results from `pooling.pooled`, with or without embodiment, or from `reference.paper_frame`.
    """
    table = frame.rename(columns={"mastered_percent_mean": "mean", "mastered_percent_std": "std"})
    if "pool" in table:
        parts = [pooling.parts_of(pool) for pool in table["pool"]]
        single = table["embodiment"] if "embodiment" in table else [None] * len(table)
        bodies = [
            {body} if isinstance(body, str) else {member for member, _ in part}
            for body, part in zip(single, parts, strict=True)
        ]
        students = [{student for _, student in part} for part in parts]
        digits = [1] * len(table)
    else:
        bodies, students = list(table["embodiments"].map(set)), list(table["students"].map(set))
        digits = [1 if round(mean, 1) == mean else 2 for mean in table["mean"]]
    table = table.assign(
        digits=digits,
        embodiments=pd.Series([tuple(sorted(names)) for names in bodies], index=table.index, dtype=object),
        students=pd.Series([tuple(sorted(names)) for names in students], index=table.index, dtype=object),
        **{name: "" for name in ("missing", "doubt") if name not in table},
    )
    key = RESULTS[:6]  # a pool of a single embodiment occurs twice: whole, and by embodiment
    return table[RESULTS].drop_duplicates(key).sort_values(key, ignore_index=True)


def _by_settings(frame: pd.DataFrame, step: int | None) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield a remark and the results for each set of settings."""
    shipped = pooling.shipped_together(frame["environment"].unique())
    keys = frame[["engine", "environment", "challenge"]].itertuples(index=False, name=None)
    test_sets = [
        "" if pd.isna(name) or name == pooling.PLUS.join(shipped.get(key, ())) else name
        for key, name in zip(keys, frame["test_sets"], strict=True)
    ]
    frame = frame.assign(test_set=test_sets)
    for column in TABLE_CONDITIONS[:-1]:
        values = frame[column].dropna().unique()
        frame[column] = frame[column].fillna(values[0]) if len(values) == 1 else frame[column]
    groups = list(frame.groupby(TABLE_CONDITIONS, dropna=False, sort=True))
    key: Any
    for key, rows in sorted(groups, key=lambda group: -len(group[1])):
        budget, engine, physics, threshold, test_set = key
        if pd.isna(budget):
            yield "Nothing has begun.", rows
            continue
        worlds = f"physics version {physics:g}" if engine == CHIPMUNK else f"worlds of {engine}"
        text = f"After {steps_text(budget if step is None else step)} steps, {worlds}"
        if threshold != MASTERY_RETURN:
            text += f", tasks mastered over a return of {threshold:g}"
        yield f"{text}, test set {test_set}." if test_set else f"{text}.", rows


MASTERED = "mastered test tasks in per cent, mean ± standard deviation over runs"

OVERALL = "overall"

_LEVELS = {"none": "No expert knowledge", "low": "Low", "high": "High"}


def result_tables(results: TableResults) -> list[ResultTable]:
    """Return every results table that has at least one result, in the paper's order.

    The original task space of Stump Tracks has a column per level of expert knowledge, its challenges have a
    table per level, and Parkour a column per embodiment and one over all of them, or over those of the pool
    with the most teachers.
    """
    by_name = {matrix.name: matrix for matrix in results.matrices}  # with the students of `results`
    original = by_name[benchmark.ORIGINAL_SPACE.name]
    cells = {level: (original, original.embodiments, level) for level in _LEVELS}
    heading = f"Stump Tracks, original task space: {MASTERED}"
    tables = [_table(results, "original_space", heading, _LEVELS, cells)]
    matrices = {matrix.challenge: by_name[matrix.name] for matrix in benchmark.STUMP_TRACKS_CHALLENGES}
    columns = {name: benchmark.find_challenge("stump_tracks", name).title for name in matrices}
    for level in KnowledgeLevel:
        cells = {name: (matrix, matrix.embodiments, level.value) for name, matrix in matrices.items()}
        heading = f"Challenges of Stump Tracks, expert knowledge {level.value}: {MASTERED}"
        tables.append(_table(results, f"challenges_{level.value}", heading, columns, cells))
    bodies = {matrix.embodiments[0]: by_name[matrix.name] for matrix in benchmark.PARKOUR}
    any_body = next(iter(bodies.values()))
    (level,) = any_body.levels
    columns = {body: body.replace("_", " ").capitalize() for body in bodies}
    cells = {body: (matrix, (body,), level.value) for body, matrix in bodies.items()}
    rows = results.rows[results.rows["environment"] == any_body.environment]
    pools = Counter(pool for pool in rows["embodiments"] if len(pool) > 1 and bodies.keys() >= set(pool))
    pool = next((pool for pool, _ in pools.most_common(1)), tuple(bodies))
    columns[OVERALL] = "Overall" if len(pool) == len(bodies) else " and ".join(columns[body] for body in pool)
    cells[OVERALL] = (any_body, pool, level.value)
    heading = f"Parkour, expert knowledge {level.value}: {MASTERED}"
    tables.append(_table(results, "parkour", heading, columns, cells))
    return [table for table in tables if table.rows]


def hyperparameters(results: pd.DataFrame | None = None) -> ResultTable:
    """Return the table of searched hyper-parameters: values tried, the paper's choice, and the best found.

    Args:
        results: result from `search_results`; None without a search.
    """
    results = pd.DataFrame(columns=SEARCH_COLUMNS) if results is None else results
    columns = {"values": "Values tried", "chosen": "The paper's choice", "found": "Best found"}
    rows: dict[str, str] = {}
    cells: dict[tuple[str, str], TableCell] = {}
    for teacher in sorted(benchmark.TEACHER_GRIDS, key=teacher_order):
        grid, points = benchmark.TEACHER_GRIDS[teacher], results[results["searched"] == teacher]
        best = points.iloc[0] if len(points) else None
        for name, values in grid.values.items():
            key = f"{teacher}.{name}"
            rows[key] = f"{label(teacher)}: {name}"
            cells[key, "values"] = TableCell(words=", ".join(map(_plain, values)))
            cells[key, "chosen"] = TableCell(words=_plain(grid.chosen[name]))
            unknown = TableCell(missing="no point has been run to its end")
            cells[key, "found"] = unknown if best is None else TableCell(words=_plain(best["point"][name]))
        if best is not None:
            key = f"{teacher}.mastered_percent"
            rows[key] = f"{label(teacher)}: mastered %"
            cells[key, "values"] = TableCell(words=f"{len(points)} of {len(grid.points())} points run")
            chosen = points[points["chosen"]]
            cells[key, "chosen"] = (
                _number(chosen.iloc[0]) if len(chosen) else TableCell(missing="not run to its end")
            )
            cells[key, "found"] = _number(best)
    title = "Hyper-parameters of the teachers"
    return ResultTable("hyperparameters", title, "Hyper-parameter", rows, columns, cells)


def knowledge_needs() -> ResultTable:
    """Return a table of the expert knowledge that each teacher requires, can use or ignores."""
    columns = {
        "initial_distribution": "Initial distribution",
        "target_distribution": "Target distribution",
        "mastery_range": "Reward mastery range",
    }
    teachers = sorted(benchmark.KNOWLEDGE_REQUIREMENTS, key=teacher_order)
    cells = {
        (teacher, column): TableCell(words=getattr(benchmark.KNOWLEDGE_REQUIREMENTS[teacher], column).value)
        for teacher in teachers
        for column in columns
    }
    rows = {teacher: label(teacher) for teacher in teachers}
    return ResultTable(
        "expert_knowledge", "Expert knowledge that teachers use", "Teacher", rows, columns, cells
    )


def _table(
    results: TableResults,
    name: str,
    title: str,
    columns: Mapping[str, str],
    contents: Mapping[str, tuple[benchmark.Matrix, tuple[str, ...], str]],
) -> ResultTable:
    """Return a table of teachers; `contents` has the matrix, embodiments and level of each column."""
    rows, cells = results.rows, dict[tuple[str, str], TableCell]()
    for column, (matrix, bodies, level) in contents.items():
        mask = (
            (rows["environment"] == matrix.environment)
            & (rows["challenge"] == matrix.challenge)
            & (rows["expert_knowledge"] == level)
            & rows["embodiments"].map(lambda pool, bodies=bodies: pool == tuple(sorted(bodies)))
            & rows["students"].map(lambda pool, matrix=matrix: pool == tuple(sorted(matrix.students)))
        )
        cells |= {(str(row["teacher"]), column): _number(row) for _, row in rows[mask].iterrows()}
    teachers = sorted({teacher for teacher, _ in cells}, key=teacher_order)
    for teacher, (column, (_, _, level)) in itertools.product(teachers, contents.items()):
        needs = benchmark.KNOWLEDGE_REQUIREMENTS.get(teacher)
        required = needs is not None and needs.mastery_range is benchmark.Requirement.REQUIRED
        refused = required and level == KnowledgeLevel.NONE
        reason = "cannot run without the reward mastery range" if refused else "not run"
        cells.setdefault((teacher, column), TableCell(missing=reason))
    name = f"{name}-{results.name}" if results.name else name
    labels = {teacher: label(teacher) for teacher in teachers}
    remarks = (results.remark,) if results.remark else ()
    return with_best(ResultTable(name, title, "Teacher", labels, columns, cells, remarks))


def _number(row: pd.Series) -> TableCell:
    numbers: dict[str, Any] = {name: row[name] for name in ("n", "mean", "std")}
    others = {name: row[name] for name in ("digits", "missing", "doubt") if name in row}
    return TableCell(**(numbers | others))


def _plain(value: object) -> str:
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:g}" if isinstance(value, float) else str(value)
