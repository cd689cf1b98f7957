"""Commands that publish results: tables, figures, comparisons, releases."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tma_ray.cli.json_output import add_json_option, print_json
from tma_ray.cli.records import baselines_record
from tma_ray.cli.sources import add_measure, add_sources, chosen_sources
from tma_ray.command_line import CommandParser
from tma_ray.commands.places import folder, root
from tma_ray.commands.quantities import COUNT
from tma_ray.commands.texts import licence, named

NOT_WHOLE = 1

RESULTS = "results root, or the name of a baseline, as paper-2021"


def add_commands(commands: Any) -> None:
    """Adds them to the subparsers `commands`."""
    commands.add_parser(
        "tables",
        help="write the paper's tables for any results",
        description="Write the paper's tables for a results root or a released baseline.",
        populate=_add_tables,
    )
    commands.add_parser(
        "figures",
        help="write the paper's figures for any results",
        description="Write the paper's figures for a results root or a released baseline.",
        populate=_add_figures,
    )
    commands.add_parser(
        "compare",
        help="write a page that compares results with released baselines",
        description="Write a page that compares the teachers of a results root with released baselines.",
        populate=_add_compare,
        examples=(
            "tma-ray compare results --baseline paper-2021",
            "tma-ray compare results --baseline paper-2021 --baseline colleague --output comparison",
        ),
    )
    commands.add_parser(
        "baselines",
        help="list, find and verify released results",
        description="List, find and verify released results to compare with.",
        populate=_add_baselines,
    )
    commands.add_parser(
        "release",
        help="pack a finished campaign as a baseline for others",
        description="Pack the finished campaign of a results root as a baseline for others. With --shard, "
        "add its finished runs to a release that grows, or begin one.",
        populate=_add_release,
        examples=(
            "tma-ray release results mine-1.0 --licence CC-BY-4.0",
            "tma-ray release results mine-1.0 --licence CC-BY-4.0 --output s3://bucket/releases",
            "tma-ray release results growing --shard batch-1 --licence CC-BY-4.0",
        ),
    )


def _add_tables(parser: CommandParser) -> None:
    add_sources(parser, RESULTS)
    parser.add_argument(
        "--step", type=COUNT, metavar="N", help="read runs after so many steps (default: at their end)"
    )
    parser.add_argument(
        "--format", default="markdown", choices=("markdown", "latex", "csv"), help="format of the tables"
    )
    parser.add_argument(
        "-o",
        "--output",
        type=folder,
        metavar="FOLDER",
        help="folder for a file per table (default: print them)",
    )
    parser.set_defaults(command=_tables)


def _add_figures(parser: CommandParser) -> None:
    add_sources(parser, RESULTS)
    parser.add_argument(
        "-o", "--output", type=folder, required=True, metavar="FOLDER", help="folder to write to"
    )
    parser.add_argument(
        "--format", default="pdf", choices=("pdf", "svg"), help="vector format, written beside PNG"
    )
    parser.add_argument(
        "--only",
        type=named("the beginning of a figure's name"),
        metavar="NAME",
        help="beginning of the figures' names, as radar (default: all)",
    )
    parser.set_defaults(command=_figures)


def _add_compare(parser: CommandParser) -> None:
    parser.add_argument(
        "roots",
        nargs="+",
        type=root,
        metavar="ROOT",
        help="results root of your runs; several are read as one",
    )
    parser.add_argument(
        "--baseline",
        dest="baselines",
        action="append",
        required=True,
        type=named("a baseline"),
        metavar="BASELINE",
        help="name of a baseline, as paper-2021, or folder or address of results; repeatable",
    )
    parser.add_argument(
        "-o",
        "--output",
        type=folder,
        metavar="FOLDER",
        help="folder to write to, where the page has a folder named by its baselines (default: compare in "
        "the first ROOT)",
    )
    add_measure(parser)
    parser.set_defaults(command=_compare)


def _add_baselines(parser: CommandParser) -> None:
    what = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    what.add_parser(
        "list",
        help="list the baselines that have a name",
        description="List the baselines that have a name here: engine, runs, teachers, licence and place.",
        populate=_add_baselines_list,
    )
    what.add_parser(
        "path",
        help="print the folder of a baseline",
        description="Print the folder of a baseline.",
        populate=_add_baselines_path,
    )
    what.add_parser(
        "verify",
        help="check that a baseline is what was released",
        description="Check the checksums of a baseline's files against those that were released.",
        populate=_add_baselines_verify,
    )


def _add_baselines_list(parser: CommandParser) -> None:
    add_json_option(parser)
    parser.set_defaults(command=_list_baselines)


def _add_baselines_path(parser: CommandParser) -> None:
    parser.add_argument("name", type=named("a baseline"), metavar="BASELINE", help="its name")
    parser.set_defaults(command=_baseline_path)


def _add_baselines_verify(parser: CommandParser) -> None:
    help_ = "name, folder or address of the baseline"
    parser.add_argument("name", type=named("a baseline"), metavar="BASELINE", help=help_)
    parser.set_defaults(command=_verify_baseline)


def _add_release(parser: CommandParser) -> None:
    from tma_ray.campaign.option_values import names

    parser.add_argument("root", type=root, metavar="ROOT", help="results root of the campaign")
    parser.add_argument("name", type=named("a name"), metavar="NAME", help="name of the baseline")
    parser.add_argument(
        "-o",
        "--output",
        type=root,
        metavar="FOLDER",
        help="folder or address in which the baseline's own folder, NAME, is made (default: the current one)",
    )
    parser.add_argument(
        "--licence",
        type=licence,
        metavar="LICENCE",
        help="licence of the results, as CC-BY-4.0 (default: none)",
    )
    parser.add_argument("--partial", action="store_true", help="allow missing runs, and mark the baseline so")
    parser.add_argument(
        "--lean",
        action="store_true",
        help="leave out episodes, logs of teachers, policies and names of machines: 20 kB a run",
    )
    parser.add_argument(
        "--shard",
        type=named("a name"),
        metavar="NAME",
        help="add the finished runs that the release lacks, lean, as files of this name (default: pack all)",
    )
    parser.add_argument(
        "--core",
        type=names,
        default=(),
        metavar="NAME,...",
        help="campaigns that 'tma-ray campaign --like' repeats (default: all)",
    )
    parser.add_argument(
        "--gaps",
        type=named("a sentence"),
        metavar="TEXT",
        help="campaigns that the release is to have and that have not begun, for its card (default: none)",
    )
    parser.set_defaults(command=_release)


def _tables(options: argparse.Namespace) -> int:
    from analysis.commands.tables import write_tables

    written = write_tables(chosen_sources(options), options.step, options.format, options.output)
    for warning in written.warnings:
        sys.stderr.write(f"tma-ray: warning: {warning}\n")
    print("\n".join(map(str, written.files)) if written.files else written.text)
    return 0


def _figures(options: argparse.Namespace) -> int:
    from analysis.commands.figures import write_figures

    written = write_figures(chosen_sources(options), options.output, options.format, options.only or "")
    for warning in (*written.warnings, *(f"left out: {text}" for text in written.left_out)):
        sys.stderr.write(f"tma-ray: warning: {warning}\n")
    print("\n".join(map(str, written.files)))
    return 0


def _compare(options: argparse.Namespace) -> int:
    from analysis.pages.compare import write_comparison

    print(write_comparison(options.roots, options.baselines, options.output, print, options.measure))
    return 0


def _list_baselines(options: argparse.Namespace) -> int:
    if options.json:
        print_json("baselines list", baselines_record())
        return 0
    from analysis.commands.baselines import show_baselines

    show_baselines()
    return 0


def _baseline_path(options: argparse.Namespace) -> int:
    from analysis.baselines import find_baseline

    print(find_baseline(options.name).place)
    return 0


def _verify_baseline(options: argparse.Namespace) -> int:
    from analysis.commands.baselines import show_verification

    return 0 if show_verification(options.name) else NOT_WHOLE


def _release(options: argparse.Namespace) -> int:
    from analysis.baselines import check_address, publish

    place = options.output or ""
    if "://" not in place:
        print(_packed(options, Path(place)))
        return 0
    if options.shard:
        raise ValueError("--shard adds to a release in a folder: publish it from there when it is whole")
    address = f"{place.rstrip('/')}/{options.name}"
    check_address(address)
    with TemporaryDirectory(prefix="tma_ray_release_") as aside:
        print(publish(_packed(options, Path(aside)), address))
    return 0


def _packed(options: argparse.Namespace, output: Path) -> Path:
    """Returns the folder of the release, or of that to which a shard was added."""
    from analysis.baselines import About, add_to_release, release
    from tma_ray.results import LEAN, WHOLE

    where, licence = (options.root, options.name), options.licence or ""
    about = About(tuple(options.core), options.gaps or "")
    if options.shard:
        return add_to_release(*where, options.shard, output, licence, about=about)
    contents = LEAN if options.lean else WHOLE
    return release(*where, output, licence, partial=options.partial, contents=contents, about=about)
