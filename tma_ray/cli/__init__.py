"""The command `tma-ray`. Each command imports what it needs when it is used."""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

from tma_ray import __version__
from tma_ray.benchmark import BENCHMARK_VERSION
from tma_ray.cli import (
    completion,
    experimenting,
    importing,
    looking,
    naming,
    policies,
    publishing,
    running,
    verifying,
)
from tma_ray.command_line import CommandParser

REFUSED = 2


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command; returns its exit code."""
    options = _parser().parse_args(arguments)
    from tma_ray.results import RootInUseError

    sys.path.insert(0, str(Path.cwd()))  # so that module:Name finds the user's own file
    command: Callable[[argparse.Namespace], int] = options.command
    warnings.showwarning = _show_warning
    try:
        return command(options)
    except (ValueError, ConnectionError, RootInUseError) as error:
        sys.stderr.write(f"tma-ray: {error}\n")
        return REFUSED


def _parser() -> CommandParser:
    parser = CommandParser(
        prog="tma-ray", description="Compare automatic curriculum learning teachers of deep RL students."
    )
    parser.add_argument("--version", action="version", version=_version())
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    groups = running, experimenting, looking, verifying, policies, publishing, importing, naming, completion
    for group in groups:
        group.add_commands(commands)
    parser.set_defaults(parser=parser)
    return parser


def _version() -> str:
    return f"tma_ray {__version__}, benchmark version {BENCHMARK_VERSION}"


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    sys.stderr.write(f"tma-ray: warning: {message}\n")
