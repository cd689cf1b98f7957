"""The results that a command reads: one root or several, and baselines by name."""

from __future__ import annotations

import argparse
from typing import Any

from tma_ray.commands.places import root
from tma_ray.commands.texts import named


def add_sources(parser: Any, what: str = "results root, or the name of a baseline with runs") -> None:
    """Adds roots and baselines to the options of a command that reads results."""
    parser.add_argument(
        "roots", nargs="+", type=root, metavar="ROOT", help=f"{what}; several are read as one"
    )
    parser.add_argument(
        "--baseline",
        dest="baselines",
        action="append",
        type=named("a baseline"),
        default=[],
        metavar="BASELINE",
        help="also the runs of this baseline: its name, folder or address; repeatable",
    )


def add_measure(parser: Any) -> None:
    """Adds what teachers are tested on to the options of a command."""
    parser.add_argument(
        "--measure",
        choices=("mastered_percent", "last_three", "mastered_area"),
        default="mastered_percent",
        help="quantity that teachers are ranked by and tested on: test tasks mastered at the last "
        "evaluation, at the last three on average, or over training (area under the curve)",
    )


def chosen_sources(options: argparse.Namespace) -> tuple[str, ...]:
    """Returns all roots and baselines that were given, in their order."""
    return (*options.roots, *options.baselines)
