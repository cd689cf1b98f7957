"""Commands that import what the original release published, from the user's own copy."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from typing import Any

from tma_ray.command_line import CommandParser
from tma_ray.commands.places import folder, new_file, root, source
from tma_ray.commands.quantities import MEBIBYTES

NOT_WHOLE = 1


def add_commands(commands: Any) -> None:
    """Adds them to the subparsers `commands`."""
    commands.add_parser(
        "import",
        help="import results, test sets or weights of the original release",
        description="Import what the original release published, from a copy of your own.",
        populate=_populate,
    )


def _populate(parser: CommandParser) -> None:
    what = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    what.add_parser(
        "results",
        help="import its per-seed files as a results root, marked as Box2D's",
        description="Import the per-seed files of the original release as a results root, marked as Box2D's.",
        populate=_add_results,
    )
    what.add_parser(
        "test-sets",
        help="import its test sets as CSV files, for --test-set",
        description="Import the test sets of the original release as CSV files, for --test-set.",
        populate=_add_test_sets,
    )
    what.add_parser(
        "weights",
        help="import its CPPN's weights as a .npz file, for Parkour",
        description="Import the weights of the original release's CPPN as a .npz file, for Parkour's option "
        "cppn_weights.",
        populate=_add_weights,
    )


def _add_results(parser: CommandParser) -> None:
    from tma_ray.importing import LARGEST_MEBIBYTES

    parser.add_argument("source", type=source, metavar="SOURCE", help="folder with any number of experiments")
    parser.add_argument(
        "-o", "--output", type=root, required=True, metavar="ROOT", help="empty folder or address to write to"
    )
    parser.add_argument(
        "--largest-pickle",
        type=MEBIBYTES,
        default=LARGEST_MEBIBYTES,
        metavar="MIB",
        help="refuse larger pickles",
    )
    parser.set_defaults(command=_results)


def _add_test_sets(parser: CommandParser) -> None:
    parser.add_argument("source", type=source, metavar="SOURCE", help="folder or file: .csv, .npy or .pkl")
    parser.add_argument(
        "-o", "--output", type=folder, required=True, metavar="FOLDER", help="folder to write to"
    )
    parser.add_argument(
        "--by-position", action="store_true", help="take columns by position, whatever the header calls them"
    )
    parser.set_defaults(command=_test_sets)


def _add_weights(parser: CommandParser) -> None:
    parser.add_argument("source", type=source, metavar="SOURCE", help="a .npz file or a pickle of arrays")
    parser.add_argument(
        "-o", "--output", type=new_file, required=True, metavar="FILE", help=".npz file to write"
    )
    parser.set_defaults(command=_weights)


def _results(options: argparse.Namespace) -> int:
    from rich.progress import track

    from tma_ray.importing import import_results
    from tma_ray.terminal import terminal

    bar = terminal(stderr=True)
    done = import_results(
        options.source,
        options.output,
        options.largest_pickle,
        lambda seeds: track(seeds, "importing", console=bar),
    )
    _list("passed by, as their names ask for", dict.fromkeys(done.ignored, ""))
    _list("the same files as another seed, and so the same run", done.copies)
    _list("imported in part", {name: "; ".join(notes) for name, notes in done.notes.items()})
    _list("imported as unfinished", done.unfinished)
    _list("left out", done.left_out)
    print(
        f"{options.output}: {done.finished:,} runs of Box2D, {len(done.unfinished):,} unfinished, "
        f"{len(done.left_out):,} seeds left out"
    )
    return NOT_WHOLE if done.left_out or done.unfinished or done.notes else 0


def _test_sets(options: argparse.Namespace) -> int:
    from tma_ray.envs import ENVIRONMENTS
    from tma_ray.importing.test_sets import read_test_sets, write_test_sets

    found, left_out = read_test_sets(options.source, by_position=options.by_position)
    for each in found:
        each.tests.check(ENVIRONMENTS.get(each.environment).valid_domain)  # type: ignore[attr-defined]
    _list("left out", left_out)
    for path, each in zip(write_test_sets(found, options.output), found, strict=True):
        print(f"{path}: {len(each.tests)} tasks of {each.environment}")
    return NOT_WHOLE if left_out else 0


def _weights(options: argparse.Namespace) -> int:
    from tma_ray.importing.weights import read_weights, write_weights

    network, names = read_weights(options.source)
    write_weights(network, options.output)
    print(f"{options.output}: {', '.join(f'{ours} was {theirs}' for ours, theirs in names.items())}")
    return 0


def _list(title: str, reasons: Mapping[str, str]) -> None:
    if reasons:
        sys.stderr.write(f"tma-ray: {title}:\n")
    for name, reason in reasons.items():
        sys.stderr.write(f"  {name}{': ' if reason else ''}{reason}\n")
