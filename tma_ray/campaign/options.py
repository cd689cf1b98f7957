"""The options that every campaign shares, as a script or as a command."""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace

from tma_ray.campaign.cluster.base import check_address
from tma_ray.campaign.option_values import (
    bodies,
    names,
    parse_address,
    parse_assignment,
    parse_levels,
    parse_results,
    parse_seeds,
    parse_source,
    parse_space,
)
from tma_ray.campaign.placing.options import add_placing_options, placed
from tma_ray.campaign.plan import CampaignSpec
from tma_ray.campaign.settings import Nodes, Settings
from tma_ray.commands.quantities import COUNT, SECONDS
from tma_ray.commands.texts import named
from tma_ray.part_names import join_name
from tma_ray.runs import Cell, Schedule

LISTS = {
    "teachers": ("NAME", "teachers, with hyper-parameters if wanted, as in alp_gmm:fit_every=100,riac"),
    "students": ("NAME", "students, with hyper-parameters if wanted, as in sac:learning_rate=3e-4,ppo"),
    "challenges": ("NAME", "challenges of the environment"),
    "embodiments": (
        "NAME",
        "bodies or paths of their files, with parameters if wanted, as in spider:size=1.2",
    ),
    "expert-knowledge": ("LEVEL", "levels of expert knowledge offered to the teachers: none, low, high"),
}
"""Options that take lists: the kind of their entries, and what they choose."""

SCHEDULE = {
    "steps": "training budget of each run, in environment steps",
    "evaluation-interval": "environment steps between two evaluations on the test set",
    "probe-interval": "environment steps between two probes of the curriculum",
    "probe-size": "tasks that a probe asks the teacher for",
    "training-window": "environment steps in a window of training statistics",
}
"""Options of the schedule, and what they set."""

YES = (
    "start what takes over an hour on this machine; without it that is asked at a terminal, and refused "
    "elsewhere or with --address"
)


def add_options(parser: argparse.ArgumentParser, campaign: CampaignSpec) -> None:
    """Adds the options of a campaign: what to run, by default what `campaign` has, and how."""
    defaults = _defaults(campaign)
    what = add_choice_options(parser, defaults)
    what.add_argument(
        "--environment",
        type=named("the name of an environment"),
        metavar="NAME",
        help=f"registered name or module:Name (default: {defaults['environment']})",
    )
    add_cell_options(what)
    add_execution_options(parser)
    add_results_option(parser)


def add_choice_options(
    parser: argparse.ArgumentParser, defaults: Mapping[str, str]
) -> argparse._ArgumentGroup:
    """Adds the options that choose what to run of anything, and returns their group.

    Args:
        parser: where to.
        defaults: what holds without each option, by its name, for the help.
    """
    what = parser.add_argument_group("what to run")
    for name, (kind, choice) in LISTS.items():
        what.add_argument(
            f"--{name}",
            type=bodies if name == "embodiments" else names,
            metavar=f"{kind},...",
            help=f"{choice} (default: {defaults[name]})",
        )
    what.add_argument(
        "--seeds",
        type=parse_seeds,
        metavar="SEEDS",
        help=f"how many seeds (4), or which: a range (8-11) or a list (0,5) (default: {defaults['seeds']})",
    )
    add_schedule_options(what, defaults)
    what.add_argument(
        "--independent-levels",
        action="store_true",
        help="repeat runs with other random numbers that cells of several levels could share",
    )
    return what


def add_schedule_options(group: argparse._ActionsContainer, defaults: Mapping[str, str]) -> None:
    """Adds the options of the budget and its intervals; see `add_choice_options` for `defaults`."""
    for name, meaning in SCHEDULE.items():
        group.add_argument(
            f"--{name}", type=COUNT, metavar="N", help=f"{meaning} (default: {defaults[name]})"
        )


def schedule_defaults(schedule: Schedule) -> dict[str, str]:
    """Returns the values of a schedule as the help shows them, by the names of their options."""
    return {name: f"{getattr(schedule, name.replace('-', '_')):,}" for name in SCHEDULE}


def _defaults(campaign: CampaignSpec) -> dict[str, str]:
    """Returns what a campaign has, as the help shows it, by the names of options."""
    fields_of = {
        **{name: name.removesuffix("s") for name in LISTS},
        "expert-knowledge": "expert_knowledge",
        "environment": "environment",
    }
    listed = {
        name: ",".join(dict.fromkeys(str(getattr(cell, field)) for cell in campaign.cells))
        for name, field in fields_of.items()
    }
    first = campaign.seeds == tuple(range(len(campaign.seeds)))
    seeds = str(len(campaign.seeds)) if first else ",".join(map(str, campaign.seeds))
    defaults = {**listed, "seeds": seeds, **schedule_defaults(campaign.schedule)}
    return {name: value.replace("%", "%%") or "none" for name, value in defaults.items()}


def add_cell_options(group: argparse._ActionsContainer) -> None:
    """Adds the options of cells that have one value for all of them."""
    group.add_argument(
        "--space",
        type=parse_space,
        metavar="SPACE",
        help="other bounds of the task space, as in stump_height=0:0.3,obstacle_spacing=3:6 (default: the "
        "challenge's)",
    )
    group.add_argument(
        "--environment-option",
        dest="environment_options",
        type=parse_assignment,
        action="append",
        metavar="NAME=VALUE",
        help="option of the environment, as in swinging_creepers=true; repeatable (default: the "
        "environment's)",
    )
    group.add_argument(
        "--test-set",
        type=named("the name of a test set"),
        metavar="NAME",
        help="shipped test set, or path of a CSV file (default: the challenge's)",
    )


def add_results_option(parser: argparse.ArgumentParser) -> None:
    """Adds the option that says where results are written."""
    parser.add_argument(
        "--results",
        type=parse_results,
        default="results",
        metavar="ROOT",
        help="folder, s3:// or gs:// to write to",
    )


def add_execution_options(parser: argparse.ArgumentParser) -> argparse._ArgumentGroup:
    """Adds the options that choose how to run it, and returns their group."""
    how = parser.add_argument_group("how to run it")
    where = how.add_mutually_exclusive_group()
    where.add_argument(
        "--local", action="store_true", help="start a Ray on this machine, whatever RAY_ADDRESS says"
    )
    where.add_argument(
        "--address",
        type=parse_address,
        metavar="ADDRESS",
        help="host:port of a Ray cluster's head, or auto (default: RAY_ADDRESS, else a Ray on this machine)",
    )
    how.add_argument(
        "--autoscaling",
        action="store_true",
        help="the cluster adds nodes: accept runs that fit none of today's",
    )
    add_placing_options(how)
    _add_times(how)
    how.add_argument(
        "--start-from",
        type=parse_source,
        metavar="ROOT",
        help="results root or release whose runs are copied first and not repeated (default: none)",
    )
    how.add_argument("--dry-run", action="store_true", help="print what would run, and stop")
    how.add_argument("--yes", action="store_true", help=YES)
    return how


def _add_times(group: argparse._ActionsContainer) -> None:
    """Adds the options that say how long something may take."""
    group.add_argument(
        "--checkpoint-seconds",
        type=SECONDS,
        default=Settings.checkpoint_seconds,
        metavar="SECONDS",
        help="longest time between two checkpoints of a run",
    )
    group.add_argument(
        "--outage-seconds",
        type=SECONDS,
        default=Settings.outage_seconds,
        metavar="SECONDS",
        help="how long the storage of the results may be unavailable before runs count as lost",
    )
    group.add_argument(
        "--unreachable-seconds",
        type=SECONDS,
        default=Settings.unreachable_seconds,
        metavar="SECONDS",
        help="how long a run or a cohort's learner may not answer before it counts as lost",
    )


def chosen_campaign(campaign: CampaignSpec, options: argparse.Namespace) -> CampaignSpec:
    """Returns `campaign` with what the flags replace: each combination of the values given."""
    return replace(
        campaign,
        cells=_replace_cells(campaign.cells, options),
        seeds=options.seeds if options.seeds is not None else campaign.seeds,
        schedule=replace_schedule(campaign.schedule, options),
        independent_levels=campaign.independent_levels or options.independent_levels,
    )


def chosen_settings(options: argparse.Namespace) -> Settings:
    """Returns how the flags want a campaign executed."""
    settings = Settings(
        checkpoint_seconds=options.checkpoint_seconds,
        outage_seconds=options.outage_seconds,
        unreachable_seconds=options.unreachable_seconds,
        autoscaling=options.autoscaling,
    )
    return placed(options, settings)


def chosen_address(options: argparse.Namespace) -> str | None:
    """Returns the cluster's address, None for a Ray on this machine."""
    return None if options.local else options.address or os.environ.get("RAY_ADDRESS") or None


def chosen_nodes(options: argparse.Namespace) -> Nodes | None:
    """Returns the nodes of the cluster that would execute a campaign; None for this machine, and a dry run.

    Raises:
        ValueError: an address that cannot be a cluster's.
        ConnectionError: no cluster answers there, or it has another token.
    """
    address = chosen_address(options)
    if address is None or options.dry_run:
        return None
    from tma_ray.campaign.cluster.joined import cluster_nodes

    check_address(address)
    gpus = chosen_settings(options).device != "cpu"
    return cluster_nodes(address, gpus=gpus, autoscaling=options.autoscaling)


def environment_name(name: str, options: argparse.Namespace) -> str:
    """Returns the name of an environment with the options that the command line adds to it."""
    return name + "".join(join_name("", {key: value}) for key, value in options.environment_options or ())


def replace_schedule(schedule: Schedule, options: argparse.Namespace) -> Schedule:
    """Returns `schedule` with what the flags replace."""
    given = {field.name: getattr(options, field.name) for field in fields(Schedule)}
    return replace(schedule, **{name: value for name, value in given.items() if value is not None})


def _replace_cells(cells: Sequence[Cell], options: argparse.Namespace) -> tuple[Cell, ...]:
    """Gives every cell each combination of the given values; equal cells come out once."""
    choices = {
        "environment": (options.environment,) if options.environment else None,
        "challenge": options.challenges,
        "embodiment": options.embodiments,
        "student": options.students,
        "teacher": options.teachers,
        "expert_knowledge": parse_levels(options.expert_knowledge) if options.expert_knowledge else None,
        "test_set": (options.test_set,) if options.test_set else None,
        "space": (options.space,) if options.space else None,
    }
    result = list(cells)
    for name, values in choices.items():
        if values is not None:
            result = [replace(cell, **{name: value}) for cell in result for value in values]
    result = [replace(cell, environment=environment_name(cell.environment, options)) for cell in result]
    unique: list[Cell] = []
    for cell in result:
        if cell not in unique:
            unique.append(cell)
    return tuple(unique)
