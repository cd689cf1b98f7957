"""The size and cost of an experiment before anything runs, as a table."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from rich.console import Console
from rich.table import Table

from tma_ray.benchmark import Experiment
from tma_ray.campaign.costs.estimation import estimate
from tma_ray.campaign.experiments import experiment_plan
from tma_ray.campaign.options import chosen_nodes, chosen_settings
from tma_ray.campaign.plan import Plan
from tma_ray.terminal import terminal


@dataclass(frozen=True)
class PlannedExperiment:
    """One experiment of a plan.

    Attributes:
        name: of the experiment.
        teachers: how many run it.
        cells: combinations of body, student, teacher and level.
        asked: cells with their seeds, as the paper counts runs.
        executed: runs of its own; a run that an earlier part has, too, is executed there.
        steps: environment steps of those.
    """

    name: str
    teachers: int
    cells: int
    asked: int
    executed: int
    steps: int


def planned_experiments(plan: Plan) -> list[PlannedExperiment]:
    """Returns the experiments of `plan` in its order."""
    rows: dict[str, list[dict[str, Any]]] = {}
    for row in plan.cell_rows:
        rows.setdefault(row["experiment"], []).append(row)
    steps = {spec.run_id: spec.schedule.steps for spec in plan.runs}
    parts, seen = [], set[str]()
    for name, mine in rows.items():
        own = {row["run_id"] for row in mine} - seen
        seen |= own
        parts.append(
            PlannedExperiment(
                name=name,
                teachers=len({row["teacher"] for row in mine}),
                cells=len({_cell(row) for row in mine}),
                asked=len(mine),
                executed=len(own),
                steps=sum(steps[run_id] for run_id in own),
            )
        )
    return parts


def show_plan(experiment: Experiment, options: argparse.Namespace, console: Console | None = None) -> Plan:
    """Prints what the flags choose of `experiment`, and what it costs; returns it.

    Raises:
        ValueError: what cannot run.
    """
    plan = experiment_plan(experiment, options)
    console = terminal(console)
    console.print(f"{experiment.title}, tier {options.tier}\n", highlight=False)
    console.print(_table(planned_experiments(plan)))
    nodes = chosen_nodes(options) if options.address else None
    cost = estimate(plan, chosen_settings(options), nodes=nodes)
    console.print(cost.describe(), highlight=False, soft_wrap=True)
    return plan


def _table(parts: Sequence[PlannedExperiment]) -> Table:
    table = Table("experiment", box=None, pad_edge=False, header_style="bold")
    for heading in ("teachers", "cells", "with seeds", "executed", "steps"):
        table.add_column(heading, justify="right")
    for part in (*parts, _total(parts)):
        style = "bold" if part.name == "together" else None
        counts = (part.teachers, part.cells, part.asked, part.executed, part.steps)
        table.add_row(part.name, *(f"{count:,}" for count in counts), style=style)
    return table


def _total(parts: Sequence[PlannedExperiment]) -> PlannedExperiment:
    return PlannedExperiment(
        name="together",
        teachers=max(part.teachers for part in parts),
        cells=sum(part.cells for part in parts),
        asked=sum(part.asked for part in parts),
        executed=sum(part.executed for part in parts),
        steps=sum(part.steps for part in parts),
    )


def _cell(row: dict[str, Any]) -> tuple[Any, ...]:
    return tuple(row[name] for name in ("embodiment", "student", "teacher", "expert_knowledge"))
