"""Experiments of the benchmark: the same flags for all, a size, a cost, and then the runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from rich.console import Console
from rich.table import Table

from tma_ray.benchmark import Experiment, Matrix, Size, select
from tma_ray.campaign.costs import estimate
from tma_ray.campaign.options import (
    ExperimentOptions,
    chosen_nodes,
    chosen_settings,
    parse_levels,
    replace_schedule,
)
from tma_ray.campaign.plan import Plan, joined_plan, matrix_campaigns
from tma_ray.campaign.script import run_plan
from tma_ray.part_names import nearest
from tma_ray.results import Store, check_usable
from tma_ray.runs import Schedule
from tma_ray.terminal import terminal


def execute_experiment(experiment: Experiment, options: ExperimentOptions) -> int:
    """Run the part of `experiment` that `options` choose, after printing its size and cost.

    Returns:
        The exit code, as of `script.main`.

    Raises:
        ValueError: a run is impossible, or takes over an hour and was not confirmed.
        ConnectionError: nothing listens at the address.
        RootInUseError: another campaign is running on the results root.
    """
    plan = experiment_plan(experiment, options)
    if not options.dry_run:
        check_usable(Store.open(options.results))
    cost = estimate(plan, chosen_settings(options), nodes=chosen_nodes(options))
    terminal().print(cost.describe(), highlight=False, soft_wrap=True)
    return run_plan(plan, str(options.results), options, cost.throughputs)


def experiment_plan(experiment: Experiment, options: ExperimentOptions) -> Plan:
    """Return the runs of the part of `experiment` that the options choose.

    Stage, challenges, bodies and levels select; students take the place of the experiment's; teachers do
    where the experiment leaves them open. Seeds are places in the list of seeds that each matrix has.

    Raises:
        ValueError: a name that does not exist, or nothing left to run.
    """
    size = experiment.size_at(options.tier)
    matrices = chosen_matrices(experiment, size, options)
    given = {
        name: getattr(size, name) for name in ("evaluation_interval", "probe_interval", "training_window")
    }
    schedule = Schedule(**{name: value for name, value in given.items() if value is not None})
    if not options.teachers:
        default = _default_teachers(experiment, size)
        matrices = tuple(matrix.taught_by(default) for matrix in matrices)
    campaigns = matrix_campaigns(matrices, options.teachers or (), replace_schedule(schedule, options))
    independent = options.independent_levels
    return joined_plan(
        "_".join(filter(None, (experiment.name, options.stage))),
        [replace(campaign, independent_levels=independent) for campaign in campaigns],
    )


def chosen_matrices(experiment: Experiment, size: Size, options: ExperimentOptions) -> tuple[Matrix, ...]:
    """Return the experiment's matrices at a size, narrowed by the options.

    Raises:
        ValueError: a stage, challenge, body, level or seed that none of them has.
    """
    matrices = experiment.stage(options.stage)
    matrices = select(matrices, options.challenges) if options.challenges else matrices
    known = dict.fromkeys(body for matrix in matrices for body in matrix.embodiments)
    for body in options.embodiments or ():
        if body not in known:
            hint = nearest(body, known)
            raise ValueError(f"no embodiment {body!r} in this experiment: {hint}known: {', '.join(known)}")
    return tuple(_narrowed(matrix, size.of(matrix), options) for matrix in matrices)


def _narrowed(whole: Matrix, small: Matrix, options: ExperimentOptions) -> Matrix:
    """Return `small`, a size of `whole`, with the values of the options."""
    levels = parse_levels(options.expert_knowledge or ())
    bodies = options.embodiments or whole.embodiments
    return replace(
        small,
        embodiments=tuple(body for body in whole.embodiments if body in bodies),
        levels=tuple(level for level in whole.levels if level in levels) if levels else small.levels,
        students=options.students or small.students,
        seeds=_seeds(whole, options.seeds) if options.seeds else small.seeds,
        steps=options.steps or small.steps,
    )


def _seeds(matrix: Matrix, places: Sequence[int]) -> tuple[int, ...]:
    """Return the seeds of `matrix` at `places`."""
    if max(places) >= len(matrix.seeds):
        raise ValueError(
            f"{matrix.name} has {len(matrix.seeds)} seeds, at places 0 to {len(matrix.seeds) - 1}, and none "
            f"at place {max(places)}"
        )
    return tuple(matrix.seeds[place] for place in places)


def _default_teachers(experiment: Experiment, size: Size) -> Sequence[str]:
    """Return the default teachers of matrices that name none: those of the tier, else of the experiment.

    Raises:
        ValueError: neither names any, and a matrix leaves them open.
    """
    if not experiment.teachers and any(not matrix.teachers for matrix in experiment.matrices):
        raise ValueError(
            "which teachers? Name them with --teachers, as in --teachers mine:Teacher,random; a teacher of "
            "your own is module:Name"
        )
    return size.teachers or experiment.teachers


COMBINED = ("embodiment", "student", "teacher", "expert_knowledge")
"""Columns whose combinations count as cells of an experiment."""


@dataclass(frozen=True)
class PlannedExperiment:
    """One experiment of a plan.

    Attributes:
        name: name of the experiment.
        teachers: number of teachers.
        cells: number of combinations of body, student, teacher and level.
        asked: number of cells with their seeds, as the paper counts runs.
        executed: number of runs that no earlier part has.
        steps: environment steps of these.
    """

    name: str
    teachers: int
    cells: int
    asked: int
    executed: int
    steps: int


def planned_experiments(plan: Plan) -> list[PlannedExperiment]:
    """Return the experiments of `plan` in its order."""
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
                cells=len({tuple(row[name] for name in COMBINED) for row in mine}),
                asked=len(mine),
                executed=len(own),
                steps=sum(steps[run_id] for run_id in own),
            )
        )
    return parts


def show_plan(experiment: Experiment, options: ExperimentOptions, console: Console | None = None) -> Plan:
    """Print the size and cost of the part of `experiment` that the options choose; return its plan.

    Raises:
        ValueError: a cell that cannot run.
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
