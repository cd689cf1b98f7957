"""What a search for hyper-parameters found, beside the paper's choice."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console
from rich.table import Table

from analysis.formatting import p_value, plus_minus
from analysis.frames import Frames, load, parsed
from analysis.identity import of_searches, searches
from analysis.measures import readings
from analysis.statistics import describe, welch
from analysis.style import label
from tma_ray.benchmark import Grid, Matrix
from tma_ray.part_names import base_name

POINTS = ["searched", "experiment", "point", "chosen", "n", "mean", "std"]


def search_results(frames: Frames) -> pd.DataFrame:
    """Returns one row for each point of a grid that has results.

    Returns:
        searched (teacher, or student where students are searched), experiment, point (the
        hyper-parameters of the grid, a dict), chosen (whether it is the paper's), n, mean and std of
        mastered tasks in per cent, the best first.
    """
    rows: list[list[Any]] = []
    if not of_searches(frames.cells["experiment"]).any():
        return pd.DataFrame(rows, columns=POINTS)
    reading = readings(frames)
    reading = reading[~reading["provisional"]]
    specs = frames.cells.drop_duplicates("run_id").set_index("run_id")["spec"]
    for matrix in searches():
        grid, side = _grid(matrix)
        mine = reading[reading["experiment"].str.fullmatch(rf"{matrix.name}(_\d+)?")]
        for experiment, runs in mine.groupby("experiment"):
            point = _point(specs[runs["run_id"].iloc[0]], grid, side)
            described = describe(runs["mastered_percent"])
            name = base_name(runs[side].iloc[0])
            chosen = point == dict(grid.chosen)
            rows.append([name, experiment, point, chosen, described.n, described.mean, described.std])
    table = pd.DataFrame(rows, columns=POINTS)
    return table.sort_values(["searched", "mean"], ascending=[True, False], kind="stable", ignore_index=True)


def show_search(root: str | Path, console: Console | None = None) -> None:
    """Prints the best point of each grid beside the paper's choice, from what a root holds.

    Raises:
        ResultsRootError: there is no such root.
    """
    frames, console = load(root), console or Console()
    found = search_results(frames)
    if found.empty:
        console.print("No point of a search has been run to its end here.")
        return
    table = Table("searched", "points", "best by mean", "mastered %", box=None, pad_edge=False)
    for heading in ("the paper's choice", "mastered %", "Welch"):
        table.add_column(heading)
    reading = readings(frames)
    for name, points in found.groupby("searched", sort=True):
        table.add_row(label(str(name)), str(len(points)), *_beside(points, reading))
    console.print(table)


def _beside(points: pd.DataFrame, reading: pd.DataFrame) -> list[str]:
    """Returns the best of `points` and the paper's choice, each with its result, and a test between them."""
    best, chosen = points.iloc[0], points[points["chosen"]]
    cells = [_text(best["point"]), plus_minus(best["mean"], best["std"])]
    if chosen.empty:
        return [*cells, "not run yet", "", ""]
    theirs = chosen.iloc[0]
    samples = (
        reading[reading["experiment"] == row["experiment"]].set_index("run_id")["mastered_percent"]
        for row in (best, theirs)
    )
    test = welch(*samples)
    cells += [_text(theirs["point"]), plus_minus(theirs["mean"], theirs["std"])]
    return [*cells, test.reason or p_value(test.p)]


def _grid(matrix: Matrix) -> tuple[Grid, str]:
    """Returns the grid of `matrix`, and whether it is of the teacher or of the student."""
    if matrix.teacher_grid:
        return matrix.teacher_grid, "teacher"
    assert matrix.student_grid is not None
    return matrix.student_grid, "student"


def _point(spec: object, grid: Grid, side: str) -> dict[str, Any]:
    values = parsed(spec).get(f"{side}_hyperparameters", {})
    return {name: values.get(name) for name in grid.values}


def _text(point: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {value:g}" for name, value in point.items())
