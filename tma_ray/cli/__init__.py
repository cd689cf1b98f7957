"""The command `tma-ray`, which imports each subcommand on first use."""

import gc
import sys
import warnings
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from cyclopts import App

from tma_ray import __version__
from tma_ray.console import command_line
from tma_ray.console.exit_codes import RefusedError
from tma_ray.support.lazy_imports import docstring_of

GARBAGE_OBJECTS: Final = 200_000
"""Threshold of garbage collection, 700 by default: commands keep the data of thousands of runs, and scanning
them repeatedly would take a tenth of the time."""

COMMANDS: Mapping[str, str] = {
    "run": "run:run",
    "campaign": "run:campaign",
    "plan": "run:plan",
    "rerun": "run:rerun",
    "stop": "run:stop",
    "simulate": "run:simulate",
    "trial": "trial:trial",
    "experiment": "run:experiment",
    "quickstart": "run:quickstart",
    "status": "status:status",
    "logs": "status:logs",
    "report": "reporting:report",
    "leaderboard": "reporting:leaderboard",
    "ranking": "reporting:ranking",
    "claims": "reporting:claims",
    "search": "reporting:search",
    "tensorboard": "reporting:tensorboard",
    "wandb": "reporting:wandb",
    "render": "policies:render",
    "verify": "status:verify",
    "compact": "status:compact",
    "export": "policies:export",
    "play": "policies:play",
    "tables": "reporting:tables",
    "figures": "reporting:figures",
    "compare": "reporting:compare",
    "baselines list": "publishing:baselines_list",
    "baselines path": "publishing:baselines_path",
    "baselines verify": "publishing:baselines_verify",
    "release": "publishing:release",
    "doctor": "status:doctor",
    "list": "status:list_",
    "completion": "status:completion",
}
"""Module and function of each command, in the order of the help."""

GROUPS: Mapping[str, str] = {"baselines": "List, find and verify released results."}
"""Commands with subcommands, and their help texts."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code; see `tma_ray.console.exit_codes`."""
    words = sys.argv[1:] if arguments is None else list(arguments)
    gc.set_threshold(GARBAGE_OBJECTS)
    return command_line.run(app(), words, before=_prepare)


def app() -> App:
    """Return the command-line app, which imports each command on first use."""
    root = command_line.group(
        "tma-ray",
        "Compare automatic curriculum learning teachers of deep RL students.",
        version=_version,
        version_flags="--version",
        help_epilogue="'tma-ray COMMAND --help' describes one; --debug prints tracebacks of errors, too.",
    )
    groups = {"": root}
    for index, (words, target) in enumerate(COMMANDS.items()):
        parent, _, name = words.rpartition(" ")
        if parent not in groups:
            groups[parent] = command_line.group(parent, GROUPS[parent], sort_key=index)
            root.command(groups[parent])
        module, _, function = f"tma_ray.cli.{target}".partition(":")
        help_ = command_line.description(docstring_of(module, function) or "")
        groups[parent].command(f"{module}:{function}", name=name, help=help_, sort_key=index)
    return root


def _prepare() -> None:
    """Check that nothing hides `analysis`, search plug-ins in the current folder, too, and format warnings.

    Raises:
        RefusedError: if another module or package called `analysis` would be imported.
    """
    from tma_ray.components.registry import search_current_folder

    spec = find_spec("analysis")
    path = Path([spec.origin, *(spec.submodule_search_locations or ())][-1] or "") if spec else None
    if path and path.resolve() != Path(__file__).resolve().parents[2] / "analysis":
        raise RefusedError(
            f"{path} hides the package 'analysis' of tma_ray: rename it, or take its folder from PYTHONPATH "
            f"and start the command elsewhere"
        )
    search_current_folder()
    warnings.showwarning = _show_warning


def _version() -> str:
    from tma_ray.benchmark import BENCHMARK_VERSION

    return f"tma_ray {__version__}, benchmark version {BENCHMARK_VERSION}"


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    sys.stderr.write(f"tma-ray: warning: {message}\n")
