"""Checks of the arguments of public functions: errors say the name, its value, and what was expected."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import Enum
from functools import cache
from numbers import Integral, Real
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Final, get_args, get_origin, get_type_hints

from tma_ray.support.component_names import nearest

_IN_WORDS: Final[dict[type, str]] = {
    str: "a text",
    bool: "True or False",
    int: "a whole number",
    float: "a number",
    Mapping: "a mapping, as {'name': value}",
    Path: "a path",
    NoneType: "None",
}


def check_type(name: str, value: object, kind: type | tuple[type, ...], expected: str) -> None:
    """Refuse an argument of another type by a TypeError."""
    if not isinstance(value, kind):
        raise TypeError(f"{name} = {value!r:.60}: expected {expected}")


def check_fields(record: Any) -> None:
    """Refuse fields of a dataclass with values of other types than declared.

    Whole and real numbers are not told apart, since their ranges are checked elsewhere; choices and tuples
    have checks of their own.

    Raises:
        TypeError: a value of another type where no number was expected.
        ValueError: a value that is not a number.
    """
    for name, (kinds, expected) in _kinds_of_fields(record.__class__).items():
        value = getattr(record, name)
        if Real not in kinds:
            check_type(name, value, kinds, expected)
        elif isinstance(value, bool) or not isinstance(value, kinds):
            raise ValueError(f"{name} = {value!r:.60}: expected {expected}")


@cache
def _kinds_of_fields(record: type) -> dict[str, tuple[tuple[type, ...], str]]:
    """Return the accepted types of each field of a dataclass, and their description."""
    found = {}
    for name, hint in get_type_hints(record).items():
        hints = [
            get_origin(each) or each for each in (get_args(hint) if isinstance(hint, UnionType) else (hint,))
        ]
        if not any(each in (Any, tuple) or issubclass(each, Enum) for each in hints):
            kinds = tuple(Real if each in (int, float) else each for each in hints)
            found[name] = kinds, " or ".join(_IN_WORDS.get(each, f"a {each.__name__}") for each in hints)
    return found


def check_sequence(name: str, value: object) -> None:
    """Refuse a single text where a list of texts is expected, by a TypeError."""
    if isinstance(value, str) or not isinstance(value, Iterable):
        raise TypeError(f"{name} = {value!r:.60}: expected several, as in [{value!r:.60}]")


def check_known(kind: str, name: object, known: Iterable[str], has: str) -> None:
    """Refuse a name that is not among `known`: a ValueError with the nearest match, `has` and all names."""
    known = list(known)
    if name not in known:
        hint = nearest(str(name), known)
        raise ValueError(f"no {kind} {name!r}: {hint}{has} {', '.join(map(str, known)) or 'none'}")


def check_finite(name: str, value: Any) -> None:
    """Refuse an argument that is not a finite number by a ValueError."""
    if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value):
        raise ValueError(f"{name} = {value!r:.60}: expected a finite number")


def check_whole(name: str, value: object, least: int) -> None:
    """Refuse an argument that is not a whole number of at least `least` by a ValueError."""
    if isinstance(value, bool) or not isinstance(value, Integral) or int(value) < least:
        raise ValueError(f"{name} = {value!r:.60}: expected a whole number of at least {least}")


def check_pair(name: str, value: object, expected: str) -> None:
    """Refuse an argument that is not a sequence of two values by a ValueError."""
    if not isinstance(value, Sequence) or len(value) != 2:
        raise ValueError(f"{name} = {value!r:.60}: expected {expected}")


def check_at_least(record: object, least: float, *names: str) -> None:
    """Refuse attributes of `record` under `least`.

    Raises:
        ValueError: the message holds the attribute's name and its value.
    """
    _check_attributes(record, names, lambda value: value >= least, f"at least {least}")


def check_positive(record: object, *names: str) -> None:
    """Refuse attributes of `record` that are not over 0; None is not checked.

    Raises:
        ValueError: the message holds the attribute's name and its value.
    """
    _check_attributes(record, names, lambda value: value is None or value > 0, "more than 0")


def check_shares(record: object, *names: str) -> None:
    """Refuse attributes of `record` that are not in [0, 1].

    Raises:
        ValueError: the message holds the attribute's name and its value.
    """
    _check_attributes(record, names, lambda value: 0 <= value <= 1, "a share in [0, 1]")


def _check_attributes(
    record: object, names: Sequence[str], holds: Callable[[Any], bool], expected: str
) -> None:
    for name in names:
        value = getattr(record, name)
        if not holds(value):
            raise ValueError(f"{name} = {value!r}: expected {expected}")
