"""Values of options: lists of names, seeds, levels, task spaces and numbers of steps, parsed from text."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from tma_ray.tasks import KnowledgeLevel


def names(text: str) -> tuple[str, ...]:
    """Parses a list of names; an empty text is the one empty name, of an environment without bodies."""
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
            low, high = map(float, bounds.split(":"))
        except ValueError:
            raise argparse.ArgumentTypeError(
                f"{name}={bounds}: expected DIMENSION=LOW:HIGH, as in stump_height=0:0.3"
            ) from None
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
