"""The flags that every campaign shares, as a script or as a command."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from dataclasses import fields, replace

from tma_ray.campaign.plan import CampaignSpec
from tma_ray.campaign.settings import Resources, Settings, TeacherPlacement
from tma_ray.runs import Cell, Schedule
from tma_ray.tasks import KnowledgeLevel


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds the flags that choose what to run, and how."""
    what = add_choice_options(parser)
    what.add_argument("--environment", metavar="NAME", help="registered name or module:Name")
    what.add_argument("--test-set", metavar="NAME|CSV", help="other than the challenge's own")
    add_execution_options(parser).add_argument(
        "--results", default="results", metavar="ROOT", help="folder, s3:// or gs:// (%(default)s)"
    )


def add_choice_options(parser: argparse.ArgumentParser) -> argparse._ArgumentGroup:
    """Adds the flags that choose what to run of anything, and returns their group."""
    what = parser.add_argument_group("what to run (lists are separated by commas)")
    for name in ("teachers", "students", "challenges", "embodiments", "expert-knowledge"):
        what.add_argument(f"--{name}", type=names, metavar="A,B")
    what.add_argument("--seeds", type=parse_seeds, metavar="N|A-B|A,B", help="how many, or which")
    for field in fields(Schedule):
        flag = field.name.replace("_", "-")
        what.add_argument(f"--{flag}", type=whole_number, metavar="N")
    what.add_argument("--independent-levels", action="store_true", help="repeat runs that cells could share")
    return what


def add_execution_options(parser: argparse.ArgumentParser) -> argparse._ArgumentGroup:
    """Adds the flags that choose how to run it, and returns their group."""
    how = parser.add_argument_group("how to run it")
    where = how.add_mutually_exclusive_group()
    where.add_argument("--local", action="store_true", help="on a Ray of its own on this machine (default)")
    where.add_argument(
        "--address", default=os.environ.get("RAY_ADDRESS"), help="of a cluster's head, or 'auto'"
    )
    how.add_argument(
        "--autoscaling", action="store_true", help="the cluster adds nodes: do not ask for room before it has"
    )
    how.add_argument("--cpus-per-run", type=float, default=Resources.cpus, metavar="X")
    how.add_argument(
        "--gpus-per-run", type=float, default=Resources.gpus, metavar="X", help="share of one, as in 0.25"
    )
    how.add_argument("--memory-per-run", type=float, default=Resources.memory_gib, metavar="GIB")
    how.add_argument("--device", default=Settings.device, help="cpu or cuda (%(default)s)")
    how.add_argument("--teacher-placement", type=TeacherPlacement, choices=list(TeacherPlacement))
    how.add_argument("--checkpoint-seconds", type=float, default=Settings.checkpoint_seconds, metavar="S")
    how.add_argument("--outage-seconds", type=float, default=Settings.outage_seconds, metavar="S")
    how.add_argument("--dry-run", action="store_true", help="say what would run, and stop")
    return how


def chosen_campaign(campaign: CampaignSpec, options: argparse.Namespace) -> CampaignSpec:
    """Returns `campaign` with what the flags replace: each combination of the values given."""
    return replace(
        campaign,
        cells=_replace_cells(campaign.cells, options),
        seeds=options.seeds if options.seeds is not None else campaign.seeds,
        schedule=replace_schedule(campaign.schedule, options),
        independent_levels=campaign.independent_levels or options.independent_levels,
    )


def chosen_settings(options: argparse.Namespace) -> Settings:
    """Returns how the flags want a campaign executed."""
    return Settings(
        resources=Resources(options.cpus_per_run, options.gpus_per_run, options.memory_per_run),
        device=options.device,
        teachers=options.teacher_placement or TeacherPlacement.ACTOR,
        checkpoint_seconds=options.checkpoint_seconds,
        outage_seconds=options.outage_seconds,
        autoscaling=options.autoscaling,
    )


def chosen_address(options: argparse.Namespace) -> str | None:
    """Returns the cluster's address, None for a Ray on this machine."""
    return None if options.local else options.address or None


def names(text: str) -> tuple[str, ...]:
    """Parses a list of names; an empty text is the one empty name, of an environment without bodies."""
    return tuple(name.strip() for name in text.split(","))


def parse_seeds(text: str) -> tuple[int, ...]:
    """Parses a number of seeds ("4"), or which ones ("8-11", "0,5").

    Examples:
        >>> parse_seeds("3"), parse_seeds("8-10"), parse_seeds("0,5")
        ((0, 1, 2), (8, 9, 10), (0, 5))
    """
    try:
        if "-" in text:
            first, last = (int(part) for part in text.split("-"))
            seeds = tuple(range(first, last + 1))
        elif "," in text:
            seeds = tuple(int(part) for part in text.split(",") if part)
        else:
            seeds = tuple(range(int(text)))
    except ValueError:
        seeds = ()
    if not seeds or min(seeds) < 0:
        raise argparse.ArgumentTypeError(f"{text!r}: expected a number (4), a range (8-11) or a list (0,5)")
    return seeds


def parse_levels(given: Sequence[str]) -> tuple[KnowledgeLevel, ...]:
    """Returns the levels of expert knowledge that are called so.

    Raises:
        ValueError: one that does not exist.
    """
    unknown = [level for level in given if level not in list(KnowledgeLevel)]
    if unknown:
        raise ValueError(
            f"unknown level of expert knowledge {unknown[0]!r}: expected one of {', '.join(KnowledgeLevel)}"
        )
    return tuple(KnowledgeLevel(level) for level in given)


def whole_number(text: str) -> int:
    """Parses a number of steps: 500000, 500_000, 5e5, 500k or 20M."""
    factor = {"k": 1_000, "M": 1_000_000}.get(text[-1:], 1)
    try:
        value = float(text.rstrip("kM")) * factor
    except ValueError:
        value = 0.5
    if value < 1 or value != int(value):
        raise argparse.ArgumentTypeError(f"{text!r}: expected a whole number such as 500000, 500k or 20M")
    return int(value)


def replace_schedule(schedule: Schedule, options: argparse.Namespace) -> Schedule:
    """Returns `schedule` with what the flags replace."""
    given = {field.name: getattr(options, field.name) for field in fields(Schedule)}
    return replace(schedule, **{name: value for name, value in given.items() if value is not None})


def _replace_cells(cells: Sequence[Cell], options: argparse.Namespace) -> tuple[Cell, ...]:
    """Gives every cell each combination of the given values; equal cells come out once."""
    choices = {
        "environment": (options.environment,) if options.environment else None,
        "challenge": options.challenges,
        "embodiment": options.embodiments,
        "student": options.students,
        "teacher": options.teachers,
        "expert_knowledge": parse_levels(options.expert_knowledge) if options.expert_knowledge else None,
        "test_set": (options.test_set,) if options.test_set else None,
    }
    result = list(cells)
    for name, values in choices.items():
        if values is not None:
            result = [replace(cell, **{name: value}) for cell in result for value in values]
    unique: list[Cell] = []
    for cell in result:
        if cell not in unique:
            unique.append(cell)
    return tuple(unique)
