"""Commands that run something: one run, campaigns, plans, simulations."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tma_ray.cli.json_output import add_json_option, print_json
from tma_ray.cli.records import plan_record
from tma_ray.command_line import CommandParser

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
        "simulate",
        help="compare teachers on simulated students, without physics",
        description="Compare teachers on simulated students, without physics: minutes instead of days.",
        populate=_add_simulate,
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
    from tma_ray.runs import Cell, Placement, Schedule

    what = parser.add_argument_group("what to run")
    for name, meaning in ONE_OF_EACH.items():
        kind = "LEVEL" if name == "expert-knowledge" else "NAME"
        default = str(getattr(Cell, name.replace("-", "_")))
        what.add_argument(f"--{name}", default=default, metavar=kind, help=meaning)
    add_cell_options(what)
    what.add_argument("--seed", type=int, default=0, metavar="N", help="seed of the run")
    add_schedule_options(what, schedule_defaults(Schedule()))
    how = parser.add_argument_group("how to run it")
    how.add_argument(
        "--device", default=Placement.device, metavar="DEVICE", help="where networks live, as cpu or cuda"
    )
    how.add_argument("--threads", type=int, default=Placement.threads, metavar="N", help="torch's threads")
    how.add_argument(
        "--checkpoint-seconds",
        type=float,
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
        "--name", default="campaign", metavar="NAME", help="name of the campaign in the results"
    )
    parser.add_argument(
        "--like",
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
    parser.add_argument("experiment", metavar="EXPERIMENT", help=f"one of {known}")
    add_experiment_options(parser)
    add_json_option(parser)
    parser.set_defaults(command=_plan)


def _add_rerun(parser: CommandParser) -> None:
    from tma_ray.campaign.options import add_execution_options

    parser.add_argument("root", metavar="ROOT", help="results root of the runs")
    parser.add_argument(
        "runs", nargs="*", metavar="RUN", help="IDs of runs, or unambiguous beginnings of them"
    )
    parser.add_argument("--failed", action="store_true", help="all runs that failed")
    add_execution_options(parser)
    parser.set_defaults(command=_rerun)


def _add_stop(parser: CommandParser) -> None:
    parser.add_argument("root", metavar="ROOT", help="results root of the campaign")
    parser.set_defaults(command=_stop)


def _add_simulate(parser: CommandParser) -> None:
    from tma_ray.campaign.option_values import names, parse_seeds, whole_number
    from tma_ray.campaign.options import LISTS
    from tma_ray.testing import EPISODES

    parser.add_argument(
        "--teachers", type=names, metavar="NAME,...", help=f"{LISTS['teachers'][1]} (default: all)"
    )
    parser.add_argument(
        "--challenges", type=names, metavar="NAME,...", help="simulated challenges (default: all six)"
    )
    parser.add_argument(
        "--expert-knowledge", type=names, metavar="LEVEL,...", help="levels offered (default: none,low,high)"
    )
    parser.add_argument(
        "--seeds",
        type=parse_seeds,
        metavar="SEEDS",
        default=tuple(range(10)),
        help="how many seeds (4), or which: a range (8-11) or a list (0,5) (default: 10)",
    )
    parser.add_argument(
        "--episodes", type=whole_number, default=EPISODES, metavar="N", help="episodes of each run"
    )
    parser.add_argument("--jobs", type=whole_number, metavar="N", default=1, help="processes")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FILE",
        help="CSV or Parquet file with a row a run (default: none)",
    )
    parser.add_argument(
        "--results",
        metavar="ROOT",
        help="results root to write the runs to, for comparisons and releases (default: none)",
    )
    parser.set_defaults(command=_simulate)


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
    from tma_ray.campaign.releases.command import run_like

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
    from tma_ray.campaign.planning import show_plan

    experiment = find_experiment(options.experiment)
    if options.json:
        print_json("plan", plan_record(experiment, options))
        return 0
    show_detectable_differences(show_plan(experiment, options).cell_rows)
    return 0


def _simulate(options: argparse.Namespace) -> int:
    from rich.console import Console
    from rich.progress import track

    from analysis.commands import simulated
    from tma_ray.campaign.option_values import parse_levels
    from tma_ray.campaign.releases.simulated import write_simulated
    from tma_ray.tasks import KnowledgeLevel
    from tma_ray.teachers import TEACHERS, canonical_teacher
    from tma_ray.testing import SIMULATED_CHALLENGES, find_simulated_challenge, matrix

    if options.output:
        simulated.check_file(options.output)
    names = options.challenges or [challenge.name for challenge in SIMULATED_CHALLENGES]
    challenges = [find_simulated_challenge(name) for name in names]
    teachers = [canonical_teacher(name) for name in options.teachers or TEACHERS.names()]
    levels = parse_levels(options.expert_knowledge or tuple(KnowledgeLevel))
    cells = matrix.cells_of(teachers, challenges, levels)
    runs = matrix.run_cells(cells, options.seeds, options.episodes, options.jobs)
    total = matrix.run_count(cells, options.seeds)
    played = list(track(runs, "simulating", total, console=Console(stderr=True)))
    frame = matrix.tabulate(cells, played)
    if options.output:
        simulated.write(frame, options.output)
    if options.results:
        write_simulated(options.results, cells, played, options.episodes)
    simulated.show(frame)
    return 0


def _stop(options: argparse.Namespace) -> int:
    from tma_ray.results import Store, ask_to_stop

    print(f"asked {ask_to_stop(Store.open(options.root))} to stop; its runs leave checkpoints and it ends")
    return 0


def _rerun(options: argparse.Namespace) -> int:
    from tma_ray.campaign.rerun import rerun

    return rerun(options)
