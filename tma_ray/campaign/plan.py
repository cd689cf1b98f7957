"""Campaigns as data, and the plan of runs that each amounts to."""

from __future__ import annotations

import itertools
import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from tma_ray.commands.arguments import check_fields, check_kind, check_names
from tma_ray.commands.quantities import SEED
from tma_ray.commands.texts import counted
from tma_ray.results import check_id
from tma_ray.runs import Cell, RunSpec, Schedule, effective_spec
from tma_ray.tasks import KnowledgeLevel


@dataclass(frozen=True)
class Plan:
    """The runs and cells that a campaign executes.

    Attributes:
        name: of the campaign.
        size: what was asked for, in words.
        runs: effective specs, one per run.
        cell_rows: rows of the table of cells, without the campaign; several may name one run.
    """

    name: str
    size: str
    runs: tuple[RunSpec, ...]
    cell_rows: tuple[dict[str, Any], ...]

    def __post_init__(self) -> None:
        check_id(self.name)

    @property
    def steps(self) -> int:
        """Environment steps of all runs together."""
        return sum(spec.schedule.steps for spec in self.runs)

    @property
    def largest_budget(self) -> int:
        """Environment steps of its longest run; 0 without runs."""
        return max((spec.schedule.steps for spec in self.runs), default=0)

    def describe(self) -> str:
        """Returns the size of the campaign in one sentence."""
        shared = len(self.cell_rows) - len(self.runs)
        sharing = f" ({shared} more cells share them)" if shared > 0 else ""
        return (
            f"campaign {self.name!r}: {self.size} = {counted(len(self.runs), 'run')}{sharing}, "
            f"{self.steps:,} environment steps"
        )


@dataclass(frozen=True)
class CampaignSpec:
    """A set of cells with a budget: what one results root is filled with.

    Attributes:
        name: letters, digits, "_" and "-"; part of file names.
        cells: what to compare.
        seeds: of every cell.
        schedule: budget and intervals of every run.
        independent_levels: repeats cells whose levels of knowledge make no difference to the teacher,
            as the paper did, instead of sharing their runs.
    """

    name: str
    cells: tuple[Cell, ...]
    seeds: tuple[int, ...] = tuple(range(32))
    schedule: Schedule = field(default_factory=Schedule)
    independent_levels: bool = False

    def __post_init__(self) -> None:
        check_fields(self)
        check_id(self.name)
        check_names("cells", self.cells)
        for cell in self.cells:
            check_kind("cell", cell, Cell, "a Cell, as of cells_of")
        check_names("seeds", self.seeds)
        for seed in self.seeds:
            SEED.check("seed", seed)
        if len(set(self.seeds)) < len(self.seeds):
            raise ValueError(f"campaign {self.name!r}: a seed is listed twice in {list(self.seeds)!s:.60}")
        if not self.cells or not self.seeds:
            raise ValueError(
                f"campaign {self.name!r} has {len(self.cells)} cells and {len(self.seeds)} seeds"
            )

    def plan(self) -> Plan:
        """Returns the runs of all cells and seeds, each once.

        Raises:
            ValueError: a cell that cannot run; the message says why.
        """
        runs: dict[str, RunSpec] = {}
        rows = []
        for cell in self.cells:
            first = effective_spec(cell, 0, self.schedule, independent_levels=self.independent_levels)
            for seed in self.seeds:
                spec = replace(first, seed=seed)
                runs.setdefault(spec.run_id, spec)
                rows.append({**cell_row(self.name, cell, spec), "seed": seed, "run_id": spec.run_id})
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
    """Returns the cells of a full matrix.

    Raises:
        TypeError: one name where several are expected.
    """
    named = {"teachers": teachers, "students": students, "challenges": challenges}
    for name, values in {**named, "levels": levels, "embodiments": embodiments}.items():
        check_names(name, values)
    return tuple(
        Cell(environment, challenge, embodiment, student, teacher, level)
        for challenge, embodiment, student, level, teacher in itertools.product(
            challenges, embodiments, students, levels, teachers
        )
    )


def lease_holder(campaign: str) -> str:
    """Returns how another campaign on the same root is told who holds it."""
    return f"campaign {campaign!r} on {platform.node()}, process {os.getpid()}"


def cell_row(experiment: str, cell: Cell, spec: RunSpec) -> dict[str, Any]:
    """Returns a row of the table of cells: canonical names of its spec, and the level that was asked for."""
    return {
        "experiment": experiment,
        "environment": spec.environment,
        "challenge": spec.challenge,
        "embodiment": spec.embodiment,
        "student": spec.student,
        "teacher": spec.teacher,
        "expert_knowledge": cell.expert_knowledge.value,
    }
