"""Specifications of campaigns, built from cells or matrices, and the plans of their runs."""

import itertools
import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from tma_ray.benchmark import Matrix, find_challenge, thinned
from tma_ray.embodiments import load_embodiment
from tma_ray.results import check_id
from tma_ray.runs import Cell, RunSpec, Schedule, effective_spec
from tma_ray.support.component_names import base_name
from tma_ray.support.quantities import SEED
from tma_ray.support.texts import counted
from tma_ray.support.validation import check_fields, check_sequence, check_type
from tma_ray.tasks import KnowledgeLevel
from tma_ray.teachers import TEACHERS, knows_enough


@dataclass(frozen=True)
class Plan:
    """Runs that a campaign executes, and the cells to which they belong.

    Attributes:
        name: name of the campaign.
        size: phrase with the numbers of cells and seeds.
        runs: effective specs of the runs.
        cell_rows: rows of the table of cells, without the campaign's name; several may share a run.
    """

    name: str
    size: str
    runs: tuple[RunSpec, ...]
    cell_rows: tuple[dict[str, Any], ...]

    def __post_init__(self) -> None:
        check_id(self.name)

    @property
    def steps(self) -> int:
        """Total environment steps of all runs."""
        return sum(spec.schedule.steps for spec in self.runs)

    @property
    def budgets(self) -> dict[str, int]:
        """Environment steps of the longest run in each environment."""
        longest: dict[str, int] = {}
        for spec in self.runs:
            longest[spec.environment] = max(spec.schedule.steps, longest.get(spec.environment, 0))
        return longest

    def describe(self) -> str:
        """Describe the size of the campaign in one sentence."""
        shared = len(self.cell_rows) - len(self.runs)
        sharing = f" ({shared} more cells share them)" if shared > 0 else ""
        return (
            f"campaign {self.name!r}: {self.size} = {counted(len(self.runs), 'run')}{sharing}, "
            f"{self.steps:,} environment steps"
        )


@dataclass(frozen=True)
class CampaignSpec:
    """Set of cells to run, with seeds and a schedule.

    Attributes:
        name: letters, digits, "_" and "-"; part of file names.
        cells: cells to compare.
        seeds: seeds of every cell.
        schedule: budget and intervals of every run.
        independent_levels: True to repeat runs, as the paper did, instead of sharing them between cells whose
            levels of knowledge make no difference to the teacher.
    """

    name: str
    cells: tuple[Cell, ...]
    seeds: tuple[int, ...] = tuple(range(32))
    schedule: Schedule = field(default_factory=Schedule)
    independent_levels: bool = False

    def __post_init__(self) -> None:
        check_fields(self)
        check_id(self.name)
        check_sequence("cells", self.cells)
        for cell in self.cells:
            check_type("cell", cell, Cell, "a Cell, as of cells_of")
        check_sequence("seeds", self.seeds)
        for seed in self.seeds:
            SEED.check("seed", seed)
        if len(set(self.seeds)) < len(self.seeds):
            raise ValueError(f"campaign {self.name!r}: a seed is listed twice in {list(self.seeds)!s:.60}")
        if not self.cells or not self.seeds:
            raise ValueError(
                f"campaign {self.name!r} has {len(self.cells)} cells and {len(self.seeds)} seeds"
            )

    def plan(self) -> Plan:
        """Return the plan of the distinct runs of all cells and seeds.

        Raises:
            ValueError: if a cell cannot run.
        """
        runs: dict[str, RunSpec] = {}
        rows = []
        for cell in self.cells:
            first = effective_spec(cell, 0, self.schedule, independent_levels=self.independent_levels)
            for seed in self.seeds:
                spec = replace(first, seed=seed)
                runs.setdefault(spec.run_id, spec)
                rows.append(cell_row(self.name, cell, spec))
        size = f"{counted(len(self.cells), 'cell')} x {counted(len(self.seeds), 'seed')}"
        return Plan(self.name, size, tuple(runs.values()), tuple(rows))


def cells_of(
    teachers: Sequence[str],
    students: Sequence[str] = ("sac",),
    challenges: Sequence[str] = ("original",),
    levels: Sequence[KnowledgeLevel] = (KnowledgeLevel.NONE,),
    embodiments: Sequence[str] = ("classic_bipedal",),
    environment: str = "stump_tracks",
) -> tuple[Cell, ...]:
    """Return the cells of all combinations of the arguments.

    Raises:
        TypeError: if a single name is given instead of a sequence.
    """
    named = {"teachers": teachers, "students": students, "challenges": challenges}
    for name, values in {**named, "levels": levels, "embodiments": embodiments}.items():
        check_sequence(name, values)
    return tuple(
        Cell(environment, challenge, embodiment, student, teacher, level)
        for challenge, embodiment, student, level, teacher in itertools.product(
            challenges, embodiments, students, levels, teachers
        )
    )


def lease_holder(campaign: str) -> str:
    """Return the name under which a campaign holds the lease on a root."""
    return f"campaign {campaign!r} on {platform.node()}, process {os.getpid()}"


def cell_row(experiment: str, cell: Cell, spec: RunSpec) -> dict[str, Any]:
    """Return a row for the table of cells, with canonical names and the requested level of knowledge."""
    names = ("environment", "challenge", "embodiment", "student", "teacher", "seed", "run_id")
    requested = {"experiment": experiment, "expert_knowledge": cell.expert_knowledge.value}
    return {name: getattr(spec, name) for name in names} | requested


def matrix_cells(
    matrix: Matrix,
    teachers: Sequence[str] = (),
    teacher_hyperparameters: Mapping[str, Any] | None = None,
    student_hyperparameters: Mapping[str, Any] | None = None,
) -> tuple[Cell, ...]:
    """Return the cells of `matrix`, without teachers that need more expert knowledge than a level offers.

    Args:
        matrix: matrix to run.
        teachers: teachers of a matrix that names none; otherwise a selection of its teachers, optionally with
            other hyper-parameters.
        teacher_hyperparameters: values that differ from each teacher's defaults.
        student_hyperparameters: values that differ from each student's defaults.

    Raises:
        UnknownNameError: if a teacher is unknown.
    """
    kept: Sequence[str] = matrix.teachers or teachers
    if matrix.teachers and teachers:
        kept = [
            selected if selected != base_name(selected) else teacher
            for teacher in matrix.teachers
            for selected in teachers
            if base_name(selected) == base_name(teacher)
        ]
    values = teacher_hyperparameters or {}, student_hyperparameters or {}
    challenge = find_challenge(matrix.environment, matrix.challenge)
    tests = {
        body: thinned(challenge.test_set_of(load_embodiment(body).body_type), matrix.test_every)
        for body in (matrix.embodiments if matrix.test_every > 1 else ())
    }
    return tuple(
        Cell(
            *(matrix.environment, matrix.challenge, embodiment, student, teacher, level, *values),
            test_set=tests.get(embodiment),
        )
        for embodiment in matrix.embodiments
        for student in matrix.students
        for level in matrix.levels
        for teacher in kept
        if knows_enough(TEACHERS.get(teacher), level)
    )


def matrix_campaigns(
    matrices: Iterable[Matrix], teachers: Sequence[str] = (), schedule: Schedule | None = None
) -> tuple[CampaignSpec, ...]:
    """Return one campaign per hyper-parameter grid point of `matrices`, omitting points without cells.

    Args:
        matrices: matrices to run.
        teachers: see `matrix_cells`.
        schedule: budget and intervals, the paper's by default; a matrix's own budget takes precedence.

    Raises:
        UnknownNameError: if a teacher is unknown.
    """
    for teacher in teachers:
        TEACHERS.get(teacher)  # raises an error for an unknown teacher even if no matrix would use it
    campaigns = []
    for matrix in matrices:
        points, timing = matrix.points(), schedule or Schedule()
        timing = timing if matrix.steps is None else replace(timing, steps=matrix.steps)
        for index, point in enumerate(points):
            if cells := matrix_cells(matrix, teachers, *point):
                name = matrix.name if len(points) == 1 else f"{matrix.name}_{index:02}"
                campaigns.append(CampaignSpec(name, cells, matrix.seeds, timing))
    return tuple(campaigns)


def joined_plan(name: str, campaigns: Sequence[CampaignSpec]) -> Plan:
    """Join `campaigns` into the plan of one campaign, with an experiment for each.

    Runs are ordered by seed, then by cell, so that partial results can be compared. Cells and seeds that
    several campaigns of an experiment have count once.

    Raises:
        ValueError: if a cell cannot run, or there is nothing to run.
    """
    if not campaigns:
        raise ValueError(
            f"nothing of {name!r} is left to run: it has no such level or teacher, or no teacher knows "
            f"enough at the levels chosen"
        )
    runs: dict[str, tuple[int, RunSpec]] = {}
    rows: dict[tuple[Any, ...], dict[str, Any]] = {}
    for campaign in campaigns:
        plan = campaign.plan()
        rows |= {tuple(row.values()): row for row in plan.cell_rows}
        for spec in plan.runs:
            runs.setdefault(spec.run_id, (campaign.seeds.index(spec.seed), spec))
    ordered = sorted(runs.values(), key=lambda placed: placed[0])
    apart = {"seed", "run_id"}
    cells = {tuple(row[name] for name in row if name not in apart) for row in rows.values()}
    size = f"{counted(len(cells), 'cell')}, {len(rows)} with their seeds"
    return Plan(name, size, tuple(spec for _, spec in ordered), tuple(rows.values()))


QUICKSTART = CampaignSpec(
    name="quickstart",
    cells=cells_of(teachers=("random", "alp_gmm"), students=("ppo",)),
    seeds=(0, 1, 2),
    schedule=Schedule(
        steps=700_000, evaluation_interval=100_000, probe_interval=50_000, training_window=50_000
    ),
)
"""PPO learns to walk on Stump Tracks while ALP-GMM or Random chooses the stumps."""


def planned_experiments(plan: Plan) -> list[dict[str, Any]]:
    """Return the numbers of cells, runs and steps of each experiment in `plan`, in order.

    ``cells`` counts combinations of body, student, teacher and level; ``asked`` those with their seeds, as
    the paper counts runs; ``executed`` and ``steps`` the runs that are in no earlier experiment.
    """
    columns = ("embodiment", "student", "teacher", "expert_knowledge")
    rows: dict[str, list[dict[str, Any]]] = {}
    for row in plan.cell_rows:
        rows.setdefault(row["experiment"], []).append(row)
    steps = {spec.run_id: spec.schedule.steps for spec in plan.runs}
    parts, seen = [], set[str]()
    for name, cells in rows.items():
        new = {row["run_id"] for row in cells} - seen
        seen |= new
        parts.append(
            {
                "name": name,
                "teachers": len({row["teacher"] for row in cells}),
                "cells": len({tuple(row[column] for column in columns) for row in cells}),
                "asked": len(cells),
                "executed": len(new),
                "steps": sum(steps[run_id] for run_id in new),
            }
        )
    return parts
