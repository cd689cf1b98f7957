"""The command that compares results with what was written."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import Any

from tma_ray.cli.json_output import add_json_option, print_json
from tma_ray.command_line import CommandParser

DAMAGED = 1


def add_commands(commands: Any) -> None:
    """Adds it to the subparsers `commands`."""
    commands.add_parser(
        "verify",
        help="compare a results root or a release with what was written",
        description="Compare every file of a results root or a release with its manifests: checksums, row "
        "counts, specs with the IDs of their runs. This finds accidents of disks, copies and editors, not "
        "malice. The exit code is 1 if something is damaged; the campaign's own command repeats such runs.",
        populate=_add_verify,
        examples=("tma-ray verify results", "tma-ray verify results --json"),
    )


def _add_verify(parser: CommandParser) -> None:
    parser.add_argument("root", metavar="ROOT", help="results root, or folder or name of a release")
    add_json_option(parser)
    parser.set_defaults(command=_verify)


def _verify(options: argparse.Namespace) -> int:
    from analysis.baselines import as_baseline, verify
    from tma_ray.results import Store, verify_root

    baseline = as_baseline(options.root)
    if baseline is not None:
        released = verify(options.root)
        runs, files = baseline.manifest.holds.get("runs", 0), len(baseline.manifest.files)
        damage, unlisted = released.damage, tuple[str, ...]()
    else:
        found = verify_root(Store.open(options.root))
        runs, files, damage, unlisted = found.runs, len(found.files), found.damage, found.unlisted
    if options.json:
        record = {"root": str(options.root), "whole": not damage, "runs": runs, "files": files}
        print_json("verify", {**record, "damage": [asdict(each) for each in damage], "unlisted": unlisted})
    else:
        lines = [*map(str, damage), *(f"{path}: it belongs to no run and is ignored" for path in unlisted)]
        state = f"damaged: {len(damage):,} problems" if damage else "whole"
        print(*lines, f"{options.root} is {state}; {runs:,} runs, {files:,} files", sep="\n")
    return DAMAGED if damage else 0
