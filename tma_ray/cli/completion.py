"""The command that prints completions for shells."""

from __future__ import annotations

import argparse
from typing import Any

from tma_ray.command_line import CommandParser

SHELLS = ("bash", "zsh", "tcsh")

FILES = ("FILE", "SOURCE")
FOLDERS = ("FOLDER", "ROOT", "BASELINE", "POLICY")
"""Metavars whose values are completed as paths."""


def add_commands(commands: Any) -> None:
    """Adds it to the subparsers `commands`."""
    commands.add_parser(
        "completion",
        help="print a completion script for a shell",
        description="Print a script that completes commands, options and paths in a shell, for its "
        "start-up file.",
        populate=_populate,
        examples=(
            'eval "$(tma-ray completion bash)"   # in ~/.bashrc',
            "tma-ray completion zsh > ~/.zfunc/_tma-ray",
        ),
    )


def _populate(parser: CommandParser) -> None:
    parser.add_argument("shell", choices=SHELLS, help="the shell to complete in")
    parser.set_defaults(command=_completion)


def _completion(options: argparse.Namespace) -> int:
    import shtab

    parser: CommandParser = options.parser
    for command in parser.commands():
        for action in command._actions:
            if action.metavar in FILES:
                action.complete = shtab.FILE  # type: ignore[attr-defined]
            elif action.metavar in FOLDERS:
                action.complete = shtab.DIRECTORY  # type: ignore[attr-defined]
    print(shtab.complete(parser, options.shell))
    return 0
