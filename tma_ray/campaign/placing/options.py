"""Options that choose where runs and their teachers are, and what they occupy."""

from __future__ import annotations

import argparse
from dataclasses import replace

from tma_ray.campaign.option_values import parse_device
from tma_ray.campaign.settings import COHORT_WIDTH, PLAYER, Resources, Settings, TeacherPlacement
from tma_ray.commands.quantities import CORES, GPUS, MEMORY, WIDTH
from tma_ray.commands.texts import refused

OFF = "off"
"""No cohort, as the option says it."""


def add_placing_options(group: argparse._ActionsContainer) -> None:
    """Adds the options."""
    alone = Resources()
    group.add_argument(
        "--cpus-per-run",
        type=CORES,
        metavar="X",
        help=f"cores that a run occupies (default: {alone.cpus:g}, in a cohort {PLAYER.cpus:g})",
    )
    group.add_argument(
        "--gpus-per-run",
        type=GPUS,
        default=alone.gpus,
        metavar="X",
        help="GPUs that a run occupies which learns alone: a share of one, as 0.25, or a whole number",
    )
    group.add_argument(
        "--memory-per-run",
        type=MEMORY,
        metavar="GIB",
        help=f"memory that a run occupies (default: {alone.memory_gib:g}, in a cohort {PLAYER.memory_gib:g})",
    )
    add_device_option(group, Settings.device)
    group.add_argument(
        "--cohort",
        type=parse_cohort,
        metavar="WIDTH",
        help="runs that learn together beside each other, one learner for each WIDTH or for each GPU; or off "
        f"(default: {COHORT_WIDTH} with --device cuda, else off)",
    )
    group.add_argument(
        "--teacher-placement",
        type=TeacherPlacement,
        choices=list(TeacherPlacement),
        default=TeacherPlacement.ACTOR,
        help="teachers in actors of their own, or in the processes of their runs",
    )


def add_device_option(group: argparse._ActionsContainer, default: str) -> None:
    """Adds the option that says on which device networks live."""
    meaning = "where networks live, as cpu or cuda"
    group.add_argument("--device", type=parse_device, default=default, metavar="DEVICE", help=meaning)


def parse_cohort(text: str) -> int:
    """Parses the width of a cohort, or "off".

    Examples:
        >>> parse_cohort("48"), parse_cohort("off")
        (48, 0)
    """
    if text == OFF:
        return 0
    try:
        width: int = WIDTH(text)
    except argparse.ArgumentTypeError:
        width = 0
    if not width:
        raise refused(text, f"expected a number of slots such as {COHORT_WIDTH}, or {OFF}")
    return width


def placed(options: argparse.Namespace, settings: Settings) -> Settings:
    """Returns `settings` with what the flags say of places."""
    given = {"cpus": options.cpus_per_run, "memory_gib": options.memory_per_run}
    given = {name: value for name, value in given.items() if value is not None}
    alone = Resources(**{**given, "gpus": options.gpus_per_run})
    return replace(
        settings,
        resources=alone,
        player=replace(PLAYER, **given),
        device=options.device,
        cohort=options.cohort,
        teachers=options.teacher_placement,
    )
