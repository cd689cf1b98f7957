"""Values of options: lists of names, seeds, levels, task spaces and numbers of steps, parsed from text."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence

from tma_ray.campaign.cluster.base import host_and_port
from tma_ray.commands.places import root
from tma_ray.commands.quantities import COORDINATE, SEED
from tma_ray.commands.texts import refused
from tma_ray.part_names import nearest
from tma_ray.results import Store, check_root
from tma_ray.runs.placement import check_device
from tma_ray.tasks import KnowledgeLevel

MOST_SEEDS = 100_000
"""Seeds that one option may name."""


def names(text: str) -> tuple[str, ...]:
    """Parses a list of names."""
    found = bodies(text)
    if not all(found):
        raise refused(text, "expected names, separated by commas")
    return found


def bodies(text: str) -> tuple[str, ...]:
    """Parses a list of bodies; an empty text is the one empty name, of an environment without bodies."""
    return tuple(name.strip() for name in text.split(","))


def parse_assignment(text: str) -> tuple[str, str]:
    """Parses NAME=VALUE.

    Examples:
        >>> parse_assignment("swinging_creepers=true")
        ('swinging_creepers', 'true')
    """
    name, separator, value = text.partition("=")
    if not (name and separator):
        raise argparse.ArgumentTypeError(f"{text!r}: expected NAME=VALUE")
    return name, value


def parse_space(text: str) -> dict[str, tuple[float, float]]:
    """Parses bounds of a task space.

    Examples:
        >>> parse_space("stump_height=0:0.3,obstacle_spacing=3:6")
        {'stump_height': (0.0, 0.3), 'obstacle_spacing': (3.0, 6.0)}
    """
    space: dict[str, tuple[float, float]] = {}
    for name, bounds in map(parse_assignment, text.split(",")):
        try:
            low, high = map(COORDINATE, bounds.split(":"))
        except (ValueError, argparse.ArgumentTypeError):
            raise argparse.ArgumentTypeError(
                f"{name}={bounds}: expected DIMENSION=LOW:HIGH, as in stump_height=0:0.3"
            ) from None
        if low > high:
            raise argparse.ArgumentTypeError(f"{name}={bounds}: the low bound is over the high one")
        if name in space:
            raise argparse.ArgumentTypeError(f"{name} is given twice; give its bounds once")
        space[name] = (low, high)
    return space


def parse_seeds(text: str) -> tuple[int, ...]:
    """Parses a number of seeds ("4"), or which ones ("8-11", "0,5").

    Examples:
        >>> parse_seeds("3"), parse_seeds("8-10"), parse_seeds("0,5")
        ((0, 1, 2), (8, 9, 10), (0, 5))
    """
    numbers = tuple(map(int, re.findall(r"\d{1,19}", text, re.ASCII)))
    seeds: Sequence[int] = ()
    if re.fullmatch(r"\d{1,19}-\d{1,19}", text, re.ASCII):
        seeds = range(numbers[0], numbers[1] + 1)
    elif re.fullmatch(r"\d{1,19}(,\d{1,19})+", text, re.ASCII):
        seeds = numbers
    elif re.fullmatch(r"\d{1,19}", text, re.ASCII):
        seeds = range(numbers[0])
    if not seeds or seeds[-1] > SEED.most:
        raise refused(text, "expected a number (4), a range (8-11) or a list (0,5)")
    if len(seeds) > MOST_SEEDS or len(set(seeds)) < len(seeds):
        reason = f"more than {MOST_SEEDS:,} seeds" if len(seeds) > MOST_SEEDS else "a seed is given twice"
        raise refused(text, reason)
    return tuple(seeds)


def parse_levels(given: Sequence[str]) -> tuple[KnowledgeLevel, ...]:
    """Returns the levels of expert knowledge that are called so.

    Raises:
        ValueError: one that does not exist.
    """
    unknown = [level for level in given if level not in list(KnowledgeLevel)]
    if unknown:
        raise ValueError(
            f"unknown level of expert knowledge {unknown[0]!r}: {nearest(unknown[0], KnowledgeLevel)}"
            f"expected one of {', '.join(KnowledgeLevel)}"
        )
    return tuple(KnowledgeLevel(level) for level in given)


def parse_device(text: str) -> str:
    """Parses torch's name of a device."""
    try:
        check_device(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    return text


def parse_results(text: str) -> str:
    """Returns the results root to write to that `text` names: a folder, there or to be made, or an address.

    Raises:
        argparse.ArgumentTypeError: it cannot be one.
    """
    if "://" not in root(text):
        try:
            Store.open(text).check_place()
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from error
    return text


def parse_source(text: str) -> str:
    """Parses a results root or a release to read, which has to be one."""
    try:
        check_root(Store.open(root(text)))
    except (ValueError, OSError) as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    return text


def parse_address(text: str) -> str:
    """Parses the address of a Ray cluster, which need not answer."""
    try:
        host_and_port(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    return text
