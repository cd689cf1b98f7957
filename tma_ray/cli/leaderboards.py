"""The command that prints leaderboards of releases."""

from __future__ import annotations

import argparse
from typing import Any

from tma_ray.command_line import CommandParser


def add_commands(commands: Any) -> None:
    """Adds it to the subparsers `commands`."""
    commands.add_parser(
        "leaderboard",
        help="print ranks, results and cost of the teachers of releases",
        description="Print the leaderboard of releases: the ranks of teachers over all challenges with what "
        "of them is certain, their results on each challenge with intervals, and what their runs cost.",
        populate=_add_leaderboard,
        examples=("tma-ray leaderboard", "tma-ray leaderboard colleague"),
    )


def _add_leaderboard(parser: CommandParser) -> None:
    parser.add_argument(
        "releases",
        nargs="*",
        metavar="BASELINE",
        help="releases, or folders or addresses of results (default: those that ship with runs)",
    )
    parser.set_defaults(command=_leaderboard)


def _leaderboard(options: argparse.Namespace) -> int:
    from analysis.commands.leaderboard import show_leaderboards

    show_leaderboards(options.releases)
    return 0
