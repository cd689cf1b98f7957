"""Matrices of the benchmark as campaigns."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from tma_ray.benchmark import Matrix
from tma_ray.campaign.campaign import Campaign
from tma_ray.runs import Cell, Schedule
from tma_ray.teachers import TEACHERS, knows_enough


def matrix_cells(matrix: Matrix, teachers: Sequence[str]) -> tuple[Cell, ...]:
    """Returns the cells of `matrix` that `teachers` know enough for; the others are left out.

    Raises:
        UnknownNameError: no such teacher.
    """
    return tuple(
        Cell(matrix.environment, matrix.challenge, embodiment, student, teacher, level)
        for embodiment in matrix.embodiments
        for student in matrix.students
        for level in matrix.levels
        for teacher in teachers
        if knows_enough(TEACHERS.get(teacher), level)
    )


def matrix_campaigns(
    matrices: Iterable[Matrix], teachers: Sequence[str], schedule: Schedule | None = None
) -> tuple[Campaign, ...]:
    """Returns a campaign for each of `matrices`, with its seeds; the paper's budget unless told otherwise.

    Raises:
        UnknownNameError: no such teacher.
        ValueError: a matrix of which no teacher can run any cell.
    """
    schedule = schedule or Schedule()
    return tuple(
        Campaign(matrix.name, matrix_cells(matrix, teachers), matrix.seeds, schedule) for matrix in matrices
    )
