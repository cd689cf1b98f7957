"""Results of searches for hyper-parameters, point by point."""

from __future__ import annotations

from typing import Any

import pandas as pd

from analysis.data.frames import Frames
from analysis.data.identity import of_searches, searches
from analysis.data.specs import parsed
from analysis.measures.evaluations import final_evaluations
from analysis.statistics import describe
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
    finals = final_evaluations(frames)
    finals = finals[~finals["provisional"]]
    specs = frames.cells.drop_duplicates("run_id").set_index("run_id")["spec"]
    for matrix in searches():
        grid, side = _grid(matrix)
        mine = finals[finals["experiment"].str.fullmatch(rf"{matrix.name}(_\d+)?")]
        for experiment, runs in mine.groupby("experiment"):
            point = _point(specs[runs["run_id"].iloc[0]], grid, side)
            described = describe(runs["mastered_percent"])
            name = base_name(runs[side].iloc[0])
            chosen = point == dict(grid.chosen)
            rows.append([name, experiment, point, chosen, described.n, described.mean, described.std])
    table = pd.DataFrame(rows, columns=POINTS)
    return table.sort_values(["searched", "mean"], ascending=[True, False], kind="stable", ignore_index=True)


def _grid(matrix: Matrix) -> tuple[Grid, str]:
    """Returns the grid of `matrix`, and whether it is of the teacher or of the student."""
    if matrix.teacher_grid:
        return matrix.teacher_grid, "teacher"
    assert matrix.student_grid is not None
    return matrix.student_grid, "student"


def _point(spec: object, grid: Grid, side: str) -> dict[str, Any]:
    values = parsed(spec).get(f"{side}_hyperparameters", {})
    return {name: values.get(name) for name in grid.values}
