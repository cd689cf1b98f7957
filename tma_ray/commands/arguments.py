"""Checks of arguments of functions that users call from Python: a mistake is refused where it was made."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from numbers import Integral, Real
from typing import Any

from tma_ray.part_names import nearest


def check_kind(name: str, value: object, kind: type | tuple[type, ...], expected: str) -> None:
    """Refuses an argument of another type.

    Raises:
        TypeError: the message holds the argument's `name`, its value and what was `expected`.
    """
    if not isinstance(value, kind):
        raise TypeError(f"{name} = {value!r:.60}: expected {expected}")


def check_names(name: str, value: object) -> None:
    """Refuses one text where several are meant: its characters would be taken for them.

    Raises:
        TypeError: as of `check_kind`, also for what cannot be iterated over.
    """
    if isinstance(value, str) or not isinstance(value, Iterable):
        raise TypeError(f"{name} = {value!r:.60}: expected several, as in [{value!r:.60}]")


def check_known(kind: str, name: object, known: Iterable[str], has: str) -> None:
    """Refuses a name that is not among `known`.

    Raises:
        ValueError: the message holds the nearest match, and what `has` which names.
    """
    known = list(known)
    if name not in known:
        hint = nearest(str(name), known)
        raise ValueError(f"no {kind} {name!r}: {hint}{has} {', '.join(map(str, known)) or 'none'}")


def check_finite(name: str, value: Any) -> None:
    """Refuses what is not a finite number.

    Raises:
        ValueError: the message holds the argument's `name` and its value.
    """
    if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value):
        raise ValueError(f"{name} = {value!r:.60}: expected a finite number")


def check_whole(name: str, value: object, least: int) -> None:
    """Refuses what is not a whole number of at least `least`.

    Raises:
        ValueError: the message holds the argument's `name` and its value.
    """
    if isinstance(value, bool) or not isinstance(value, Integral) or int(value) < least:
        raise ValueError(f"{name} = {value!r:.60}: expected a whole number of at least {least}")


def check_pair(name: str, value: object, expected: str) -> None:
    """Refuses what is not two values in order.

    Raises:
        ValueError: the message holds the argument's `name`, its value and what was `expected`.
    """
    if not isinstance(value, Sequence) or len(value) != 2:
        raise ValueError(f"{name} = {value!r:.60}: expected {expected}")
