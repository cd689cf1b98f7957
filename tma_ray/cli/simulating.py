"""The command that compares teachers on simulated students."""

from __future__ import annotations

import argparse
import sys
from contextlib import closing
from typing import Any

from tma_ray.command_line import CommandParser
from tma_ray.commands.exits import FAILED
from tma_ray.commands.places import new_file, root
from tma_ray.commands.quantities import COUNT, PROCESSES
from tma_ray.commands.texts import counted


def add_commands(commands: Any) -> None:
    """Adds it to the subparsers `commands`."""
    commands.add_parser(
        "simulate",
        help="compare teachers on simulated students, without physics",
        description="Compare teachers on simulated students, without physics: minutes instead of days.",
        populate=_add_simulate,
    )


def _add_simulate(parser: CommandParser) -> None:
    from tma_ray.campaign.option_values import names, parse_seeds
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
    parser.add_argument("--episodes", type=COUNT, default=EPISODES, metavar="N", help="episodes of each run")
    parser.add_argument("--jobs", type=PROCESSES, metavar="N", default=1, help="processes")
    parser.add_argument(
        "-o",
        "--output",
        type=new_file,
        metavar="FILE",
        help="CSV or Parquet file with a row a run (default: none)",
    )
    parser.add_argument(
        "--results",
        type=root,
        metavar="ROOT",
        help="results root to write each run to as it ends; runs that it has are not played again "
        "(default: none)",
    )
    parser.set_defaults(command=_simulate)


def _simulate(options: argparse.Namespace) -> int:
    from rich.progress import track

    from analysis.commands import simulated
    from tma_ray.campaign.option_values import parse_levels
    from tma_ray.campaign.simulated import SimulatedRoot
    from tma_ray.tasks import KnowledgeLevel
    from tma_ray.teachers import TEACHERS, canonical_teacher
    from tma_ray.terminal import terminal
    from tma_ray.testing import SIMULATED_CHALLENGES, find_simulated_challenge, matrix

    if options.output:
        simulated.check_file(options.output)
    names = options.challenges or [challenge.name for challenge in SIMULATED_CHALLENGES]
    challenges = [find_simulated_challenge(name) for name in names]
    teachers = [canonical_teacher(name) for name in options.teachers or TEACHERS.names()]
    levels = parse_levels(options.expert_knowledge or tuple(KnowledgeLevel))
    cells = matrix.cells_of(teachers, challenges, levels)
    asked = cells, options.seeds, options.episodes
    root = SimulatedRoot(options.results, *asked) if options.results else None
    played = root.kept() if root else []
    total = matrix.run_count(cells, options.seeds) - len(played)
    runs = matrix.run_cells(*asked, options.jobs, tuple(played))
    try:
        with closing(runs):
            for run in track(runs, "simulating", total, console=terminal(stderr=True)):
                if root:
                    root.add(run)
                played.append(run)
    except matrix.ProcessLostError as error:
        following = "the same command plays the others" if root else "with --results they would be kept"
        sys.stderr.write(f"tma-ray: {error}; done so far: {counted(len(played), 'run')}; {following}\n")
        return FAILED
    frame = matrix.tabulate(cells, played)
    if options.output:
        simulated.write(frame, options.output)
    simulated.show(frame)
    return 0
