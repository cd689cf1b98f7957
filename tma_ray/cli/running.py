"""Commands that run something: one run, campaigns, plans, simulations."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def add_commands(commands: Any) -> None:
    """Adds them to the subparsers `commands`."""
    _add_run(commands.add_parser("run", help="one run in this process, without Ray"))
    _add_campaign(commands.add_parser("campaign", help="a matrix of runs on Ray"))
    _add_plan(commands.add_parser("plan", help="what an experiment of the benchmark comes to and costs"))
    _add_simulate(commands.add_parser("simulate", help="teachers of simulated students, without physics"))
    _add_rerun(commands.add_parser("rerun", help="runs of a results root again that failed"))
    stop = commands.add_parser("stop", help="ask the campaign on a results root to leave with checkpoints")
    stop.add_argument("root", metavar="ROOT")
    stop.set_defaults(command=_stop)


def _add_run(parser: argparse.ArgumentParser) -> None:
    from tma_ray.campaign.options import whole_number

    parser.add_argument("--environment", default="stump_tracks", metavar="NAME")
    parser.add_argument("--challenge", default="original", metavar="NAME")
    parser.add_argument("--embodiment", default="classic_bipedal", metavar="NAME")
    parser.add_argument("--student", default="sac", metavar="NAME")
    parser.add_argument("--teacher", default="random", metavar="NAME")
    parser.add_argument("--expert-knowledge", default="none", metavar="LEVEL")
    parser.add_argument("--test-set", metavar="NAME|CSV")
    parser.add_argument("--seed", type=int, default=0)
    for flag in ("steps", "evaluation-interval", "probe-interval", "training-window"):
        parser.add_argument(f"--{flag}", type=whole_number, metavar="N")
    parser.add_argument("--results", default="results", metavar="ROOT")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--checkpoint-seconds", type=float, default=600.0, metavar="S")
    parser.set_defaults(command=_run)


def _add_campaign(parser: argparse.ArgumentParser) -> None:
    from tma_ray.campaign.options import add_options

    parser.add_argument("--name", default="campaign", help="of the campaign in the results (%(default)s)")
    add_options(parser)
    parser.set_defaults(command=_campaign)


def _add_plan(parser: argparse.ArgumentParser) -> None:
    from tma_ray.benchmark import EXPERIMENTS
    from tma_ray.campaign.experiments import add_experiment_options

    known = ", ".join(experiment.name for experiment in EXPERIMENTS)
    parser.add_argument("experiment", metavar="EXPERIMENT", help=known)
    add_experiment_options(parser)
    parser.set_defaults(command=_plan)


def _add_rerun(parser: argparse.ArgumentParser) -> None:
    from tma_ray.campaign.options import add_execution_options

    parser.add_argument("root", metavar="ROOT")
    parser.add_argument("runs", nargs="*", metavar="RUN", help="ids, or unambiguous beginnings of them")
    parser.add_argument("--failed", action="store_true", help="all that failed")
    add_execution_options(parser)
    parser.set_defaults(command=_rerun)


def _add_simulate(parser: argparse.ArgumentParser) -> None:
    from tma_ray.campaign.options import names, parse_seeds, whole_number
    from tma_ray.tasks import KnowledgeLevel

    parser.add_argument("--teachers", type=names, metavar="A,B", help="default: all of the catalogue")
    parser.add_argument("--challenges", type=names, metavar="A,B", help="default: all six")
    parser.add_argument("--expert-knowledge", type=names, metavar="A,B", default=tuple(KnowledgeLevel))
    parser.add_argument("--seeds", type=parse_seeds, metavar="N|A-B|A,B", default=tuple(range(10)))
    parser.add_argument("--episodes", type=whole_number, metavar="N", help="default: 10,000")
    parser.add_argument("--jobs", type=whole_number, metavar="N", default=1, help="processes (%(default)s)")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE.csv", help="or FILE.parquet: a row a run")
    parser.set_defaults(command=_simulate)


def _run(options: argparse.Namespace) -> int:
    from tma_ray.campaign.single import run_single

    return run_single(options)


def _campaign(options: argparse.Namespace) -> int:
    from tma_ray.campaign.campaign import Campaign
    from tma_ray.campaign.script import execute
    from tma_ray.runs import Cell

    return execute(Campaign(options.name, cells=(Cell(),)), options)


def _plan(options: argparse.Namespace) -> int:
    from analysis.planning import show_detectable_differences
    from tma_ray.benchmark import find_experiment
    from tma_ray.campaign.planning import show_plan

    show_detectable_differences(show_plan(find_experiment(options.experiment), options).cell_rows)
    return 0


def _simulate(options: argparse.Namespace) -> int:
    from rich.console import Console
    from rich.progress import track

    from analysis import simulated
    from tma_ray.campaign.options import parse_levels
    from tma_ray.teachers import TEACHERS
    from tma_ray.testing import EPISODES, SIMULATED_CHALLENGES, find_simulated_challenge, matrix

    if options.output:
        simulated.check_file(options.output)
    names = options.challenges or [challenge.name for challenge in SIMULATED_CHALLENGES]
    challenges = [find_simulated_challenge(name) for name in names]
    teachers, levels = options.teachers or TEACHERS.names(), parse_levels(options.expert_knowledge)
    cells = matrix.cells_of(teachers, challenges, levels)
    runs = matrix.run_cells(cells, options.seeds, options.episodes or EPISODES, options.jobs)
    total = matrix.run_count(cells, options.seeds)
    frame = matrix.tabulate(cells, track(runs, "simulating", total, console=Console(stderr=True)))
    if options.output:
        simulated.write(frame, options.output)
    simulated.show(frame)
    return 0


def _stop(options: argparse.Namespace) -> int:
    from tma_ray.results import Store, ask_to_stop

    print(f"asked {ask_to_stop(Store.open(options.root))} to stop; its runs leave checkpoints and it ends")
    return 0


def _rerun(options: argparse.Namespace) -> int:
    from tma_ray.campaign.rerun import rerun

    return rerun(options)
