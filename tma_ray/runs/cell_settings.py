"""Settings of a cell's environment and challenge, checked, and the canonical names that show them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from tma_ray.envs import ENVIRONMENTS
from tma_ray.hyperparameters import differing, parameters_of, parse_settings, plain
from tma_ray.part_names import base_name, join_name, nearest, split_name, text_of
from tma_ray.tasks import TaskSpace

BOUNDS_SEPARATOR = ".."
"""Between the bounds of a dimension in the name of a challenge."""

Bounds = Mapping[str, Sequence[float]]
"""Low and high of dimensions of a task space, by name."""

_ELSEWHERE = {"embodiment": "--embodiment or Cell.embodiment", "render_mode": "no run; runs draw nothing"}
"""Parameters of an environment's constructor that a cell cannot set, and who chooses them."""


def environment_settings(name: str, options: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Returns the canonical name of an environment, and the options that differ from its defaults.

    Args:
        name: registered name or ``module:Name``, with options if wanted (``parkour:swinging_creepers=true``).
        options: further options of its constructor.

    Raises:
        UnknownNameError: no such environment.
        ValueError: an option that it does not have or that is chosen elsewhere, or a value of another type.
    """
    base, text = split_name(name)
    environment = ENVIRONMENTS.get(base)
    for option in (*text, *options):
        if option in _ELSEWHERE:
            raise ValueError(f"environment {base!r}: {option} cannot be set here; use {_ELSEWHERE[option]}")
    try:
        values = differing(environment, parse_settings(environment, text, options, "option"))
    except ValueError as error:
        raise ValueError(f"environment {base!r}: {error}") from error
    return join_name(base, values), {option: plain(value) for option, value in values.items()}


def check_body(environment: str, embodiment: str) -> None:
    """Refuses an environment with bodies that is given none: its results would not tell which it chose.

    Raises:
        UnknownNameError: no such environment.
        ValueError: none is given.
    """
    base = base_name(environment)
    if not embodiment and "embodiment" in parameters_of(ENVIRONMENTS.get(base)):
        raise ValueError(
            f"environment {base!r} has bodies: choose one with {_ELSEWHERE['embodiment']}, not ''"
        )


def challenge_bounds(name: str, space: Bounds) -> tuple[str, dict[str, tuple[float, float]]]:
    """Returns the name of a challenge without bounds, and the bounds that it is given.

    Args:
        name: of a challenge, with bounds if wanted (``original:stump_height=0..0.3``).
        space: further bounds.

    Raises:
        ValueError: bounds that are not two numbers, or given twice.
    """
    base, text = split_name(name)
    twice = sorted(set(text) & set(space))
    if twice:
        raise ValueError(f"challenge {name!r}: the bounds of {twice[0]} are given twice; give them once")
    given = {dimension: value.split(BOUNDS_SEPARATOR) for dimension, value in text.items()}
    return base, {dimension: _pair(dimension, pair) for dimension, pair in {**given, **space}.items()}


def bounded(space: TaskSpace, bounds: Bounds) -> TaskSpace:
    """Returns `space` with other bounds for some of its dimensions.

    Raises:
        ValueError: a dimension that the space does not have, or a low bound over the high one.
    """
    for dimension, (low, high) in bounds.items():
        if dimension not in space.names:
            hint = nearest(dimension, space.names)
            raise ValueError(f"unknown dimension {dimension!r}: {hint}known: {', '.join(space.names)}")
        own = space.dimensions[space.names.index(dimension)]
        if (own.low, own.high) != (low, high):
            space = space.with_bounds(dimension, low, high)
    return space


def canonical_challenge(name: str, space: TaskSpace, chosen: TaskSpace) -> str:
    """Returns the name of a challenge whose task space is `chosen` instead of its own, `space`."""
    pairs = zip(space.dimensions, chosen.dimensions, strict=True)
    others = {
        new.name: f"{text_of(float(new.low))}{BOUNDS_SEPARATOR}{text_of(float(new.high))}"
        for own, new in pairs
        if (own.low, own.high) != (new.low, new.high)
    }
    return join_name(base_name(name), others)


def _pair(dimension: str, values: Sequence[Any]) -> tuple[float, float]:
    try:
        low, high = (float(value) for value in values)
    except (TypeError, ValueError):
        low = high = math.nan
    if not (math.isfinite(low) and math.isfinite(high)):
        raise ValueError(f"bounds {values!r} of {dimension}: expected two numbers, low and high")
    return low, high
