"""Matrices of the benchmark as campaigns, and as one plan."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from tma_ray.benchmark import Matrix
from tma_ray.campaign.plan import CampaignSpec, Plan
from tma_ray.part_names import base_name
from tma_ray.runs import Cell, RunSpec, Schedule
from tma_ray.teachers import TEACHERS, knows_enough


def matrix_cells(
    matrix: Matrix,
    teachers: Sequence[str] = (),
    teacher_hyperparameters: Mapping[str, Any] | None = None,
    student_hyperparameters: Mapping[str, Any] | None = None,
) -> tuple[Cell, ...]:
    """Returns the cells of one point of `matrix` for those that know enough; the others are left out.

    Args:
        matrix: what to run.
        teachers: who runs it if the matrix does not say; else those of its own that are kept, with
            hyper-parameters that are given here, all if none is given.
        teacher_hyperparameters: values that differ from each teacher's defaults.
        student_hyperparameters: values that differ from each student's defaults.

    Raises:
        UnknownNameError: no such teacher.
    """
    return tuple(
        Cell(
            matrix.environment,
            matrix.challenge,
            embodiment,
            student,
            teacher,
            level,
            teacher_hyperparameters or {},
            student_hyperparameters or {},
        )
        for embodiment in matrix.embodiments
        for student in matrix.students
        for level in matrix.levels
        for teacher in _kept(matrix, teachers)
        if knows_enough(TEACHERS.get(teacher), level)
    )


def matrix_campaigns(
    matrices: Iterable[Matrix], teachers: Sequence[str] = (), schedule: Schedule | None = None
) -> tuple[CampaignSpec, ...]:
    """Returns a campaign for each of `matrices`, and each point of its grids, that any teacher can run.

    Args:
        matrices: what to run.
        teachers: see `matrix_cells`.
        schedule: budget and intervals, the paper's by default; a matrix with a budget has that instead.

    Raises:
        UnknownNameError: no such teacher.
    """
    for teacher in teachers:
        TEACHERS.get(teacher)  # refuses an unknown one, also where nobody would miss it
    campaigns = []
    for matrix in matrices:
        points = matrix.points()
        for place, point in enumerate(points):
            if cells := matrix_cells(matrix, teachers, *point):
                name = matrix.name if len(points) == 1 else f"{matrix.name}_{place:02}"
                campaigns.append(CampaignSpec(name, cells, matrix.seeds, _schedule(matrix, schedule)))
    return tuple(campaigns)


def joined_plan(name: str, campaigns: Sequence[CampaignSpec]) -> Plan:
    """Returns one plan for all of `campaigns`, each an experiment of the campaign `name`.

    Every cell's first seed comes before any cell's second, so that what is half done can be compared.

    Raises:
        ValueError: a cell that cannot run, or no campaign at all.
    """
    if not campaigns:
        raise ValueError(
            f"nothing of {name!r} is left to run: it has no such level or teacher, or no teacher knows "
            f"enough at the levels chosen"
        )
    runs: dict[str, tuple[int, RunSpec]] = {}
    rows: list[dict[str, Any]] = []
    for campaign in campaigns:
        plan = campaign.plan()
        rows += plan.cell_rows
        for spec in plan.runs:
            runs.setdefault(spec.run_id, (campaign.seeds.index(spec.seed), spec))
    ordered = sorted(runs.values(), key=lambda placed: placed[0])
    size = f"{sum(len(campaign.cells) for campaign in campaigns)} cells, {len(rows)} with their seeds"
    return Plan(name, size, tuple(spec for _, spec in ordered), tuple(rows))


def _kept(matrix: Matrix, teachers: Sequence[str]) -> Sequence[str]:
    if not matrix.teachers:
        return teachers
    if not teachers:
        return matrix.teachers
    return [
        given if given != base_name(given) else teacher
        for teacher in matrix.teachers
        for given in teachers
        if base_name(given) == base_name(teacher)
    ]


def _schedule(matrix: Matrix, schedule: Schedule | None) -> Schedule:
    schedule = schedule or Schedule()
    return schedule if matrix.steps is None else replace(schedule, steps=matrix.steps)
