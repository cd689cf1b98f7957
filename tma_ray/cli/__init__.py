"""The command `tma-ray`. Each command is imported when it is used."""

import gc
import sys
import warnings
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from cyclopts import App

from tma_ray import __version__
from tma_ray.console.command_line import description, group, run
from tma_ray.console.exit_codes import RefusedError
from tma_ray.support.lazy_imports import docstring_of

GARBAGE_OBJECTS: Final = 200_000
"""New objects after which Python looks for circular garbage, instead of 700: what commands read of thousands
of runs stays until its end, and looking through it over and over takes a tenth of the time."""

COMMANDS: Mapping[str, str] = {
    "run": "running:run",
    "campaign": "running:campaign",
    "plan": "running:plan",
    "rerun": "running:rerun",
    "stop": "running:stop",
    "simulate": "running:simulate",
    "trial": "trying:trial",
    "experiment": "running:experiment",
    "quickstart": "running:quickstart",
    "status": "looking:status",
    "logs": "looking:logs",
    "report": "reporting:report",
    "leaderboard": "reporting:leaderboard",
    "ranking": "reporting:ranking",
    "claims": "reporting:claims",
    "search": "reporting:search",
    "tensorboard": "reporting:tensorboard",
    "wandb": "reporting:wandb",
    "render": "policies:render",
    "verify": "looking:verify",
    "compact": "looking:compact",
    "export": "policies:export",
    "play": "policies:play",
    "tables": "reporting:tables",
    "figures": "reporting:figures",
    "compare": "reporting:compare",
    "baselines list": "publishing:baselines_list",
    "baselines path": "publishing:baselines_path",
    "baselines verify": "publishing:baselines_verify",
    "release": "publishing:release",
    "doctor": "looking:doctor",
    "list": "looking:list_",
    "completion": "looking:completion",
}
"""Modules and functions of commands, in the order of the help."""

GROUPS: Mapping[str, str] = {"baselines": "List, find and verify released results."}
"""Commands that consist of others, and their helps."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; return its exit code, see `tma_ray.console.exit_codes`."""
    words = sys.argv[1:] if arguments is None else list(arguments)
    gc.set_threshold(GARBAGE_OBJECTS)
    return run(app(), words, before=_prepare)


def app() -> App:
    """Return the command line; commands are imported when they are used, or their own help is asked for."""
    root = group(
        "tma-ray",
        "Compare automatic curriculum learning teachers of deep RL students.",
        version=_version,
        version_flags="--version",
        help_epilogue="'tma-ray COMMAND --help' describes one; --debug prints tracebacks of errors, too.",
    )
    groups = {"": root}
    for place, (words, target) in enumerate(COMMANDS.items()):
        above, _, name = words.rpartition(" ")
        if above not in groups:
            groups[above] = group(above, GROUPS[above], sort_key=place)
            root.command(groups[above])
        module, _, function = f"tma_ray.cli.{target}".partition(":")
        help_ = description(docstring_of(module, function) or "")
        groups[above].command(f"{module}:{function}", name=name, help=help_, sort_key=place)
    return root


def _prepare() -> None:
    """Make modules of the current folder known as plug-ins, after checking that none hides a package of ours.

    Raises:
        RefusedError: something lies in the place of the package `analysis`, which is next to this one.
    """
    from tma_ray.components.registry import search_current_folder

    found = find_spec("analysis")
    place = Path([found.origin, *(found.submodule_search_locations or ())][-1] or "") if found else None
    if place and place.resolve() != Path(__file__).resolve().parents[2] / "analysis":
        raise RefusedError(
            f"{place} hides the package 'analysis' of tma_ray: rename it, or take its folder from PYTHONPATH "
            f"and start the command elsewhere"
        )
    search_current_folder()
    warnings.showwarning = _show_warning


def _version() -> str:
    from tma_ray.benchmark import BENCHMARK_VERSION

    return f"tma_ray {__version__}, benchmark version {BENCHMARK_VERSION}"


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    sys.stderr.write(f"tma-ray: warning: {message}\n")
