"""Commands on the files of a results root: compared with what was written, merged."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from tma_ray.cli.json_output import add_json_option, print_json
from tma_ray.command_line import CommandParser
from tma_ray.commands.places import root
from tma_ray.commands.texts import counted

if TYPE_CHECKING:
    from analysis.baselines import Baseline

DAMAGED = 1


def add_commands(commands: Any) -> None:
    """Adds them to the subparsers `commands`."""
    commands.add_parser(
        "verify",
        help="compare a results root or a release with what was written",
        description="Compare every file of a results root or a release with its manifests: checksums, row "
        "counts, specs with the IDs of their runs. This finds accidents of disks, copies and editors, not "
        "malice. The exit code is 1 if something is damaged; the campaign's own command repeats such runs.",
        populate=_add_verify,
        examples=("tma-ray verify results", "tma-ray verify results --json"),
    )
    commands.add_parser(
        "compact",
        help="merge the files of finished runs, by experiment",
        description="Merge the table files of finished runs into one file per table and experiment.",
        populate=_add_compact,
    )


def _add_verify(parser: CommandParser) -> None:
    parser.add_argument(
        "root", type=root, metavar="ROOT", help="results root, or folder or name of a release"
    )
    parser.add_argument(
        "--complete",
        action="store_true",
        help="a release, and complete: every planned run, equal seeds, a licence, no names of machines",
    )
    add_json_option(parser)
    parser.set_defaults(command=_verify)


def _add_compact(parser: CommandParser) -> None:
    parser.add_argument("root", type=root, metavar="ROOT", help="results root")
    parser.set_defaults(command=_compact)


def _verify(options: argparse.Namespace) -> int:
    from analysis.baselines import as_baseline, verify
    from tma_ray.results import Store, verify_root

    baseline = as_baseline(options.root)
    if options.complete and baseline is None:
        raise ValueError(f"{options.root} is not a release, which --complete is about; see 'tma-ray release'")
    if baseline is not None:
        released = verify(options.root)
        runs, files = baseline.manifest.holds.get("runs", 0), len(baseline.manifest.files)
        damage, unlisted = released.damage, tuple[str, ...]()
    else:
        found = verify_root(Store.open(options.root))
        runs, files, damage, unlisted = found.runs, len(found.files), found.damage, found.unlisted
    lacks = _lacking(options, baseline) if not damage else []
    if options.json:
        record = {"root": str(options.root), "whole": not damage, "runs": runs, "files": files}
        rest = {"damage": [asdict(each) for each in damage], "unlisted": unlisted, "lacking": lacks}
        print_json("verify", record | rest)
    else:
        ignored = (f"{path}: it belongs to no run and is ignored" for path in unlisted)
        state = f"damaged: {len(damage):,} problems" if damage else "whole"
        whole = f"{options.root} is {state}; {counted(runs, 'run')}, {counted(files, 'file')}"
        print(*map(str, damage), *ignored, *lacks, whole, sep="\n")
        if options.complete and not damage:
            print(f"it is incomplete: {len(lacks)} things are missing" if lacks else "it is complete")
    return DAMAGED if damage or lacks else 0


def _lacking(options: argparse.Namespace, baseline: Baseline | None) -> list[str]:
    from analysis.baselines.verification import lacking

    return lacking(baseline) if options.complete and baseline is not None else []


def _compact(options: argparse.Namespace) -> int:
    from tma_ray.results import compact

    done = compact(options.root)
    print(
        f"{done.runs:,} runs merged: {done.files_before:,} files of tables became {done.files_after:,}, "
        f"{done.bytes_before:,} bytes {done.bytes_after:,}"
    )
    return 0
