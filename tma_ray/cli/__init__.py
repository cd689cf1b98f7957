"""The command `tma-ray`. Each command imports what it needs when it is used."""

from __future__ import annotations

import argparse
import gc
import sys
import warnings
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from tma_ray import __version__
from tma_ray.benchmark import BENCHMARK_VERSION
from tma_ray.cli import (
    completion,
    experimenting,
    looking,
    naming,
    policies,
    publishing,
    running,
    simulating,
    verifying,
)
from tma_ray.command_line import CommandParser
from tma_ray.commands.exits import RefusedError, exit_code
from tma_ray.registry import search_current_folder

GARBAGE_OBJECTS: Final = 200_000
"""New objects after which Python looks for circular garbage, instead of 700: what commands read of thousands
of runs stays until its end, and looking through it over and over takes a tenth of the time."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command; returns its exit code: see `tma_ray.commands.exits`."""
    words = sys.argv[1:] if arguments is None else list(arguments)
    gc.set_threshold(GARBAGE_OBJECTS)
    return exit_code("tma-ray", lambda: _run(words), debug="--debug" in words)


def _run(words: Sequence[str]) -> int:
    try:
        options = _parser().parse_args(words)
    except SystemExit as ended:  # after --help, or a sentence of the parser's
        return int(ended.code or 0)
    _refuse_shadow()
    search_current_folder()
    command: Callable[[argparse.Namespace], int] = options.command
    warnings.showwarning = _show_warning
    return command(options)


def _refuse_shadow() -> None:
    """Refuses what Python finds in the place of the package `analysis`, which lies next to this one.

    Raises:
        RefusedError: the message names it.
    """
    found = find_spec("analysis")
    place = Path([found.origin, *(found.submodule_search_locations or ())][-1] or "") if found else None
    if place and place.resolve() != Path(__file__).resolve().parents[2] / "analysis":
        raise RefusedError(
            f"{place} hides the package 'analysis' of tma_ray: rename it, or take its folder from PYTHONPATH "
            f"and start the command elsewhere"
        )


def _parser() -> CommandParser:
    parser = CommandParser(
        prog="tma-ray", description="Compare automatic curriculum learning teachers of deep RL students."
    )
    parser.add_argument("--version", action="version", version=_version())
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    groups = (
        running,
        simulating,
        experimenting,
        looking,
        verifying,
        policies,
        publishing,
        naming,
        completion,
    )
    for group in groups:
        group.add_commands(commands)
    parser.set_defaults(parser=parser)
    return parser


def _version() -> str:
    return f"tma_ray {__version__}, benchmark version {BENCHMARK_VERSION}"


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    sys.stderr.write(f"tma-ray: warning: {message}\n")
