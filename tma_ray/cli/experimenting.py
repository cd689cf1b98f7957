"""Commands that run an experiment of the benchmark, or a first campaign, from its size to its results."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tma_ray.command_line import CommandParser
from tma_ray.commands.texts import named


def add_commands(commands: Any) -> None:
    """Adds them to the subparsers `commands`."""
    commands.add_parser(
        "experiment",
        help="run an experiment of the benchmark and print its results",
        description="Run an experiment of the benchmark: print its size and its cost, train what is missing "
        "on Ray, and print the ranking of the teachers, or the best points of a search. The same command "
        "continues.",
        populate=_add_experiment,
        examples=(
            "tma-ray experiment stump_tracks_challenges --tier smoke --results smoke",
            "tma-ray experiment full_benchmark --tier lite --results lite",
            "tma-ray experiment parkour --teachers random,alp_gmm --seeds 2 --dry-run",
        ),
    )
    commands.add_parser(
        "quickstart",
        help="train a first small campaign and write its report",
        description="Compile the physics, train PPO under the teachers Random and ALP-GMM with three seeds "
        "each, and write a report: some minutes in all. The same command continues.",
        populate=_add_quickstart,
    )


def _add_experiment(parser: CommandParser) -> None:
    from tma_ray.benchmark import EXPERIMENTS
    from tma_ray.campaign.experiments import add_experiment_options

    known = ", ".join(experiment.name for experiment in EXPERIMENTS)
    expected = named("the name of an experiment")
    parser.add_argument("experiment", type=expected, metavar="EXPERIMENT", help=f"one of {known}")
    add_experiment_options(parser)
    parser.set_defaults(command=_experiment)


def _add_quickstart(parser: CommandParser) -> None:
    from tma_ray.campaign.options import add_options
    from tma_ray.campaign.plan import QUICKSTART

    add_options(parser, QUICKSTART)
    parser.set_defaults(command=_quickstart)


def _experiment(options: argparse.Namespace) -> int:
    from analysis.commands.ranking import show_ranking
    from analysis.commands.search import show_search
    from tma_ray.benchmark import find_experiment
    from tma_ray.campaign.experiments import execute_experiment

    experiment = find_experiment(options.experiment)
    code = execute_experiment(experiment, options)
    if code or options.dry_run:
        return code
    if experiment.searches:
        show_search(options.results)
    else:
        show_ranking(options.results, experiment.read_at)
    return 0


def _quickstart(options: argparse.Namespace) -> int:
    from analysis.pages.report import write_report
    from tma_ray.campaign.costs.estimation import estimate
    from tma_ray.campaign.costs.known import patient_speeds
    from tma_ray.campaign.options import chosen_campaign, chosen_nodes, chosen_settings
    from tma_ray.campaign.plan import QUICKSTART
    from tma_ray.campaign.script import execute
    from tma_ray.results import Store, check_usable

    if options.dry_run:
        return execute(QUICKSTART, options)
    check_usable(Store.open(options.results))
    plan, settings = chosen_campaign(QUICKSTART, options).plan(), chosen_settings(options)
    stages = _Stages(3)
    print(stages.begin("compilation (once)", "Compiling the physics: about half a minute, once per machine"))
    cost = estimate(plan, settings, find_speeds=patient_speeds, nodes=chosen_nodes(options))
    print(stages.begin("training", f"Training: {cost.summary()}; Ctrl-C stops, the same command continues"))
    if code := execute(QUICKSTART, options):
        return code
    print(stages.begin("report", "Writing the report: a few seconds"))
    page = write_report(options.results, Path("report") if "://" in options.results else None)
    print(stages.summary())
    print(f"Next: open {page} in a browser, then type\n  tma-ray ranking {options.results}")
    return 0


class _Stages:
    """Stages of a command that follow one another: announced, numbered and timed."""

    def __init__(self, number: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._number, self._clock = number, clock
        self._begun: list[tuple[str, float]] = []

    def begin(self, name: str, announcement: str) -> str:
        """Returns the line that announces the next stage."""
        self._begun.append((name, self._clock()))
        return f"[{len(self._begun)}/{self._number}] {announcement}"

    def summary(self) -> str:
        """Returns how long each stage took; the last ends now."""
        names, starts = zip(*self._begun, strict=True)
        ends = (*starts[1:], self._clock())
        taken = [(name, round(end - start)) for name, start, end in zip(names, starts, ends, strict=True)]
        width = max(map(len, names))
        lines = (f"  {name:{width}}  {seconds // 60} min {seconds % 60:02} s" for name, seconds in taken)
        return "\n".join(("", "Where the time went:", *lines))
