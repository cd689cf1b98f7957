"""Commands that make something of results: tables, comparisons, releases."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

NOT_WHOLE = 1


def add_commands(commands: Any) -> None:
    """Adds them to the subparsers `commands`."""
    _add_tables(commands.add_parser("tables", help="the paper's tables, of any results"))
    _add_figures(commands.add_parser("figures", help="the paper's figures, of any results"))
    _add_compare(commands.add_parser("compare", help="put results among released baselines, on one page"))
    _add_baselines(commands.add_parser("baselines", help="released results to compare with"))
    _add_release(commands.add_parser("release", help="pack a finished campaign as a baseline for others"))
    compact = commands.add_parser("compact", help="merge the files of runs that are done, by experiment")
    compact.add_argument("root", metavar="ROOT")
    compact.set_defaults(command=_compact)


def _add_tables(parser: argparse.ArgumentParser) -> None:
    from tma_ray.campaign.options import whole_number

    parser.add_argument("root", metavar="ROOT|NAME", help="results, or a baseline such as paper-2021")
    parser.add_argument("--step", type=whole_number, metavar="N", help="read runs after so many steps")
    parser.add_argument("--format", default="markdown", choices=("markdown", "latex", "csv"))
    parser.add_argument("-o", "--output", type=Path, metavar="FOLDER", help="a file for each table")
    parser.set_defaults(command=_tables)


def _add_figures(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("root", metavar="ROOT|NAME", help="results, or a baseline such as paper-2021")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--format", default="pdf", choices=("pdf", "svg"), help="beside PNG (%(default)s)")
    parser.add_argument("--only", default="", metavar="NAME", help="beginning of the names wanted, as radar")
    parser.set_defaults(command=_figures)


def _add_compare(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("root", metavar="ROOT", help="your results")
    parser.add_argument(
        "--baseline",
        dest="baselines",
        action="append",
        default=[],
        metavar="NAME|ROOT",
        help="paper-2021, or a folder or address of results; several times for several",
    )
    parser.add_argument("-o", "--output", type=Path, metavar="FOLDER", help="default: ROOT/compare")
    parser.set_defaults(command=_compare)


def _add_baselines(parser: argparse.ArgumentParser) -> None:
    what = parser.add_subparsers(required=True, metavar="WHAT")
    what.add_parser("list", help="those that have a name here").set_defaults(command=_list_baselines)
    path = what.add_parser("path", help="where one lies")
    path.add_argument("name", metavar="NAME")
    path.set_defaults(command=_baseline_path)
    verify = what.add_parser("verify", help="whether one is what was released")
    verify.add_argument("name", metavar="NAME|FOLDER")
    verify.set_defaults(command=_verify_baseline)


def _add_release(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("root", metavar="ROOT")
    parser.add_argument("name", metavar="NAME", help="of the baseline")
    parser.add_argument("-o", "--output", type=Path, metavar="FOLDER", help="default: NAME")
    parser.add_argument("--licence", default="", metavar="ID", help="as in CC-BY-4.0")
    parser.add_argument("--partial", action="store_true", help="though runs are missing, and say so")
    parser.set_defaults(command=_release)


def _tables(options: argparse.Namespace) -> int:
    from analysis.tables_command import write_tables

    written = write_tables(options.root, options.step, options.format, options.output)
    for warning in written.warnings:
        sys.stderr.write(f"tma-ray: warning: {warning}\n")
    print("\n".join(map(str, written.files)) if written.files else written.text)
    return 0


def _figures(options: argparse.Namespace) -> int:
    from analysis.figures_command import write_figures

    written = write_figures(options.root, options.output, options.format, options.only)
    for warning in (*written.warnings, *(f"left out: {text}" for text in written.left_out)):
        sys.stderr.write(f"tma-ray: warning: {warning}\n")
    print("\n".join(map(str, written.files)))
    return 0


def _compare(options: argparse.Namespace) -> int:
    from analysis.compare_page import write_comparison

    print(write_comparison(options.root, options.baselines, options.output))
    return 0


def _list_baselines(_: argparse.Namespace) -> int:
    from analysis.baselines.commands import show_baselines

    show_baselines()
    return 0


def _baseline_path(options: argparse.Namespace) -> int:
    from analysis.baselines import find_baseline

    print(find_baseline(options.name).place)
    return 0


def _verify_baseline(options: argparse.Namespace) -> int:
    from analysis.baselines.commands import show_verification

    return 0 if show_verification(options.name) else NOT_WHOLE


def _release(options: argparse.Namespace) -> int:
    from analysis.baselines import release

    print(release(options.root, options.name, options.output, options.licence, partial=options.partial))
    return 0


def _compact(options: argparse.Namespace) -> int:
    from tma_ray.results import compact

    done = compact(options.root)
    print(
        f"{done.runs:,} runs merged: {done.files_before:,} files of tables became {done.files_after:,}, "
        f"{done.bytes_before:,} bytes {done.bytes_after:,}"
    )
    return 0
