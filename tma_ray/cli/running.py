"""Commands that run something: one run, campaigns, plans."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from tma_ray.cli.json_output import add_json_option, print_json
from tma_ray.cli.records import plan_record
from tma_ray.command_line import CommandParser
from tma_ray.commands.places import root
from tma_ray.commands.quantities import PROCESSES, SECONDS, SEED
from tma_ray.commands.texts import named

if TYPE_CHECKING:
    from tma_ray.campaign import Campaign

ONE_OF_EACH = {
    "environment": "registered name or module:Name",
    "challenge": "challenge of the environment",
    "embodiment": "body or path of its file, with parameters if wanted, as in spider:size=1.2",
    "student": "student, with hyper-parameters if wanted, as in sac:learning_rate=3e-4",
    "teacher": "teacher, with hyper-parameters if wanted, as in alp_gmm:fit_every=100",
    "expert-knowledge": "what the teacher is told: none, low or high",
}
"""Options that choose a cell."""


def add_commands(commands: Any) -> None:
    """Adds them to the subparsers `commands`."""
    commands.add_parser(
        "run",
        help="train one student under one teacher, without Ray",
        description="Train one student under one teacher in this process, without Ray. The results go "
        "where those of campaigns go, and the same command continues a run that was interrupted.",
        populate=_add_run,
        examples=(
            "tma-ray run --teacher alp_gmm --student ppo --steps 200k",
            "tma-ray run --student ppo:learning_rate=1e-4:hidden_units=64x64 --steps 200k",
            "tma-ray run --student ppo --space stump_height=0:0.3,obstacle_spacing=3:6 --steps 200k",
        ),
    )
    commands.add_parser(
        "campaign",
        help="run a matrix of cells with their seeds on Ray",
        description="Run every combination of teachers, students, challenges, bodies and levels of "
        "expert knowledge, with its seeds, on Ray. Runs that are done are not repeated: the same command "
        "continues.",
        populate=_add_campaign,
        examples=(
            "tma-ray campaign --teachers random,alp_gmm --students ppo --seeds 4 --steps 500k",
            "tma-ray campaign --teachers alp_gmm,alp_gmm:fit_every=100 --students ppo --seeds 4 --steps 500k",
            "tma-ray campaign --teachers random,riac --seeds 2 --dry-run",
            "tma-ray campaign --like colleague --teachers random --results mine --dry-run",
        ),
    )
    _add_comparing(commands)


def _add_comparing(commands: Any) -> None:
    commands.add_parser(
        "plan",
        help="print the size and the cost of an experiment of the benchmark",
        description="Print the cells, runs and steps of an experiment of the benchmark, the hours, disk "
        "and memory that they take at the speed of this machine, and the differences that its seeds can "
        "detect.",
        populate=_add_plan,
    )
    commands.add_parser(
        "rerun",
        help="run failed or unfinished runs of a results root again",
        description="Run failed or unfinished runs of a results root again, from their checkpoints where "
        "they have some.",
        populate=_add_rerun,
    )
    commands.add_parser(
        "stop",
        help="stop the campaign on a results root; its runs leave checkpoints",
        description="Ask the campaign on a results root to stop: its runs leave checkpoints, and the "
        "command that started it continues them.",
        populate=_add_stop,
    )


def _add_run(parser: CommandParser) -> None:
    from tma_ray.campaign.options import (
        YES,
        add_cell_options,
        add_results_option,
        add_schedule_options,
        schedule_defaults,
    )
    from tma_ray.campaign.placing.options import add_device_option
    from tma_ray.runs import Cell, Placement, Schedule

    what = parser.add_argument_group("what to run")
    for name, meaning in ONE_OF_EACH.items():
        kind = "LEVEL" if name == "expert-knowledge" else "NAME"
        default = str(getattr(Cell, name.replace("-", "_")))
        text = str if name == "embodiment" else named(f"the name of a {name.replace('-', ' ')}")
        what.add_argument(f"--{name}", type=text, default=default, metavar=kind, help=meaning)
    add_cell_options(what)
    what.add_argument("--seed", type=SEED, default=0, metavar="N", help="seed of the run")
    add_schedule_options(what, schedule_defaults(Schedule()))
    how = parser.add_argument_group("how to run it")
    add_device_option(how, Placement.device)
    how.add_argument(
        "--threads", type=PROCESSES, default=Placement.threads, metavar="N", help="torch's threads"
    )
    how.add_argument(
        "--checkpoint-seconds",
        type=SECONDS,
        default=Placement.checkpoint_seconds,
        metavar="SECONDS",
        help="longest time between two checkpoints",
    )
    how.add_argument("--yes", action="store_true", help=YES)
    add_results_option(parser)
    parser.set_defaults(command=_run)


def _add_campaign(parser: CommandParser) -> None:
    from tma_ray.campaign.options import add_options

    parser.add_argument(
        "--name",
        type=named("a name"),
        default="campaign",
        metavar="NAME",
        help="name of the campaign in the results",
    )
    parser.add_argument(
        "--like",
        type=named("a release"),
        metavar="BASELINE",
        help="release whose cells, seeds and settings are repeated for --teachers; --challenges and --seeds "
        "narrow them (default: none)",
    )
    add_options(parser, _one_cell("campaign"))
    parser.set_defaults(command=_campaign)


def _add_plan(parser: CommandParser) -> None:
    from tma_ray.benchmark import EXPERIMENTS
    from tma_ray.campaign.experiments import add_experiment_options

    known = ", ".join(experiment.name for experiment in EXPERIMENTS)
    expected = named("the name of an experiment")
    parser.add_argument("experiment", type=expected, metavar="EXPERIMENT", help=f"one of {known}")
    add_experiment_options(parser)
    add_json_option(parser)
    parser.set_defaults(command=_plan)


def _add_rerun(parser: CommandParser) -> None:
    from tma_ray.campaign.options import add_execution_options

    parser.add_argument("root", type=root, metavar="ROOT", help="results root of the runs")
    parser.add_argument(
        "runs",
        nargs="*",
        type=named("the ID of a run"),
        metavar="RUN",
        help="IDs of runs, or unambiguous beginnings of them",
    )
    parser.add_argument("--failed", action="store_true", help="all runs that failed")
    add_execution_options(parser)
    parser.set_defaults(command=_rerun)


def _add_stop(parser: CommandParser) -> None:
    parser.add_argument("root", type=root, metavar="ROOT", help="results root of the campaign")
    parser.set_defaults(command=_stop)


def _run(options: argparse.Namespace) -> int:
    from tma_ray.campaign.single import run_single

    return run_single(options)


def _campaign(options: argparse.Namespace) -> int:
    from tma_ray.campaign.script import execute

    if options.like:
        return _campaign_like(options)
    return execute(_one_cell(options.name), options)


def _campaign_like(options: argparse.Namespace) -> int:
    from analysis.baselines import as_baseline
    from tma_ray.campaign.repeating import run_like

    baseline = as_baseline(options.like)
    place, core = (baseline.place, baseline.manifest.core) if baseline else (options.like, ())
    return run_like(place, core, options)


def _one_cell(name: str) -> Campaign:
    """Returns the campaign whose values the options replace."""
    from tma_ray.campaign import Campaign
    from tma_ray.runs import Cell

    return Campaign(name, cells=(Cell(),))


def _plan(options: argparse.Namespace) -> int:
    from analysis.commands.planning import show_detectable_differences
    from tma_ray.benchmark import find_experiment
    from tma_ray.campaign.experiments import show_plan
    from tma_ray.results import Store, check_usable

    experiment = find_experiment(options.experiment)
    check_usable(Store.open(options.results))
    if options.json:
        print_json("plan", plan_record(experiment, options))
        return 0
    plan = show_plan(experiment, options)
    show_detectable_differences(plan.cell_rows, plan.largest_budget)
    return 0


def _stop(options: argparse.Namespace) -> int:
    from tma_ray.results import Store, ask_to_stop

    print(
        f"asked {ask_to_stop(Store.open(options.root))} to stop; its runs leave checkpoints and it ends. "
        f"Next: 'tma-ray status {options.root}' shows when; the command that started it continues it"
    )
    return 0


def _rerun(options: argparse.Namespace) -> int:
    from tma_ray.campaign.repeating import rerun

    return rerun(options)
