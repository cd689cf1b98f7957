"""Planning, cost estimates and execution of the benchmark's experiments."""

from dataclasses import replace

from rich.table import Table

from tma_ray.benchmark import Experiment, Matrix, Size, Tier, select
from tma_ray.campaign.costs import Cost, estimate
from tma_ray.campaign.options import ExperimentOptions, parse_levels
from tma_ray.campaign.plan import Plan, joined_plan, matrix_campaigns, planned_experiments
from tma_ray.campaign.script import run_plan
from tma_ray.console.terminal import print_line, terminal
from tma_ray.runs import Schedule
from tma_ray.support.component_names import nearest


def execute_experiment(experiment: Experiment, options: ExperimentOptions) -> int:
    """Print the size and cost of the selected part of `experiment`, and run it; see `run_plan`."""
    for reason in exclusions(experiment, options):
        print_line(reason)
    return run_plan(experiment_plan(experiment, options), str(options.results), options, show_cost=True)


def experiment_plan(experiment: Experiment, options: ExperimentOptions) -> Plan:
    """Return the plan of the selected part of `experiment`.

    The options' stage, challenges, bodies and levels narrow the experiment. Their students replace its own,
    as do their teachers where it leaves them open. Their seeds are indices into each matrix's seeds.

    Raises:
        ValueError: if a name is unknown, or nothing is left to run.
    """
    size = experiment.size_at(options.tier)
    matrices = chosen_matrices(experiment, size, options)
    given = {
        name: getattr(size, name) for name in ("evaluation_interval", "probe_interval", "training_window")
    }
    schedule = Schedule(**{name: value for name, value in given.items() if value is not None})
    if not options.teachers:
        if not experiment.teachers and any(not matrix.teachers for matrix in experiment.matrices):
            raise ValueError(
                "which teachers? Name them with --teachers, as in --teachers mine:Teacher,random; a teacher "
                "of your own is module:Name"
            )
        default = size.teachers or experiment.teachers
        matrices = tuple(matrix.taught_by(default) for matrix in matrices)
    campaigns = matrix_campaigns(matrices, options.teachers or (), options.schedule(schedule))
    return joined_plan(
        "_".join(filter(None, (experiment.name, options.stage))),
        [replace(campaign, independent_levels=options.independent_levels) for campaign in campaigns],
    )


def exclusions(experiment: Experiment, options: ExperimentOptions) -> list[str]:
    """Return the tier's reasons for leaving out selected bodies."""
    reasons = experiment.size_at(options.tier).excluded_bodies
    bodies = {body for matrix in selected_matrices(experiment, options) for body in matrix.embodiments}
    return [reason for body, reason in reasons.items() if body in bodies & set(options.embodiments or bodies)]


def selected_matrices(experiment: Experiment, options: ExperimentOptions) -> tuple[Matrix, ...]:
    """Return the matrices of the chosen stage and challenges.

    Raises:
        ValueError: if the experiment lacks the stage or a challenge.
    """
    matrices = experiment.stage(options.stage)
    return select(matrices, options.challenges) if options.challenges else matrices


def chosen_matrices(experiment: Experiment, size: Size, options: ExperimentOptions) -> tuple[Matrix, ...]:
    """Return the experiment's matrices at `size`, narrowed by the options.

    Raises:
        ValueError: if none has a selected stage, challenge, body, level or seed, or the size excludes a body.
    """
    matrices = selected_matrices(experiment, options)
    bodies = dict.fromkeys(body for matrix in matrices for body in matrix.embodiments)
    for body in options.embodiments or ():
        if body not in bodies:
            hint = nearest(body, bodies)
            raise ValueError(f"no embodiment {body!r} in this experiment: {hint}known: {', '.join(bodies)}")
        if reason := size.excluded_bodies.get(body):
            raise ValueError(
                f"embodiment {body!r}: {reason} Use --tier {Tier.PAPER}, with --steps for fewer."
            )
    levels = parse_levels(options.expert_knowledge or ())
    narrowed = []
    for whole in matrices:
        small, selected, indices = size.of(whole), options.embodiments or whole.embodiments, options.seeds
        if indices and max(indices) >= len(whole.seeds):
            raise ValueError(
                f"{whole.name} has {len(whole.seeds)} seeds, at places 0 to {len(whole.seeds) - 1}, and none "
                f"at place {max(indices)}"
            )
        narrowed.append(
            replace(
                small,
                embodiments=tuple(body for body in small.embodiments if body in selected),
                levels=tuple(level for level in whole.levels if level in levels) if levels else small.levels,
                students=options.students or small.students,
                seeds=tuple(whole.seeds[index] for index in indices) if indices else small.seeds,
                steps=options.steps or small.steps,
            )
        )
    return tuple(narrowed)


def plan_and_cost(experiment: Experiment, options: ExperimentOptions) -> tuple[Plan, Cost]:
    """Return the plan of the selected runs and its cost on this machine, or on the cluster in `options`."""
    plan, config = experiment_plan(experiment, options), options.config()
    nodes = options.nodes(config.device) if options.address else None
    return plan, estimate(plan, config, nodes=nodes)


def show_plan(title: str, plan: Plan, cost: Cost) -> None:
    """Print the size of each experiment of a plan, and the plan's cost."""
    console, parts = terminal(), planned_experiments(plan)
    table = Table("experiment", box=None, pad_edge=False, header_style="bold")
    for heading in ("teachers", "cells", "with seeds", "executed", "steps"):
        table.add_column(heading, justify="right")
    total = {name: sum(part[name] for part in parts) for name in ("cells", "asked", "executed", "steps")}
    together = {"name": "together", "teachers": max(part["teachers"] for part in parts), **total}
    for part in (*parts, together):
        name, *counts = part.values()
        table.add_row(name, *(f"{count:,}" for count in counts), style="bold" if part is together else None)
    console.print(f"{title}\n", highlight=False)
    console.print(table)
    print_line(cost.describe())
