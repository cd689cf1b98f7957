"""Checks of public arguments, with errors that state the name, the value and what was expected."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import Enum
from functools import cache
from numbers import Integral, Real
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Final, get_args, get_origin, get_type_hints

from tma_ray.support.component_names import nearest

_DESCRIPTIONS: Final[dict[type, str]] = {
    str: "a text",
    bool: "True or False",
    int: "a whole number",
    float: "a number",
    Mapping: "a mapping, as {'name': value}",
    Path: "a path",
    NoneType: "None",
}


def check_type(name: str, value: object, kind: type | tuple[type, ...], expected: str) -> None:
    """Raise a TypeError if the argument `name` is not of type `kind`."""
    if not isinstance(value, kind):
        raise TypeError(f"{name} = {value!r:.60}: expected {expected}")


def check_fields(record: Any) -> None:
    """Check that the fields of a dataclass have values of their declared types.

    Whole numbers and floats count as one type; enums and tuples are not checked.

    Raises:
        TypeError: if a value has another type.
        ValueError: if a number was expected.
    """
    for name, (kinds, expected) in _kinds_of_fields(record.__class__).items():
        value = getattr(record, name)
        if Real not in kinds:
            check_type(name, value, kinds, expected)
        elif isinstance(value, bool) or not isinstance(value, kinds):
            raise ValueError(f"{name} = {value!r:.60}: expected {expected}")


@cache
def _kinds_of_fields(record: type) -> dict[str, tuple[tuple[type, ...], str]]:
    """Return the accepted types of each field of a dataclass, and their description, by field name."""
    fields = {}
    for name, hint in get_type_hints(record).items():
        hints = get_args(hint) if isinstance(hint, UnionType) else (hint,)
        types = [get_origin(kind) or kind for kind in hints]
        if not any(kind in (Any, tuple) or issubclass(kind, Enum) for kind in types):
            kinds = tuple(Real if kind in (int, float) else kind for kind in types)
            fields[name] = kinds, " or ".join(_DESCRIPTIONS.get(kind, f"a {kind.__name__}") for kind in types)
    return fields


def check_sequence(name: str, value: object) -> None:
    """Raise a TypeError if `value` is a single string or is not iterable."""
    if isinstance(value, str) or not isinstance(value, Iterable):
        raise TypeError(f"{name} = {value!r:.60}: expected several, as in [{value!r:.60}]")


def check_known(kind: str, name: object, names: Iterable[str], has: str) -> None:
    """Raise a ValueError for an unknown name, giving the nearest match and, after `has`, all `names`."""
    names = list(names)
    if name not in names:
        hint = nearest(str(name), names)
        raise ValueError(f"no {kind} {name!r}: {hint}{has} {', '.join(map(str, names)) or 'none'}")


def check_finite(name: str, value: Any) -> None:
    """Raise a ValueError if an argument is not a finite number."""
    if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value):
        raise ValueError(f"{name} = {value!r:.60}: expected a finite number")


def check_whole(name: str, value: object, least: int) -> None:
    """Raise a ValueError if an argument is not a whole number of at least `least`."""
    if isinstance(value, bool) or not isinstance(value, Integral) or int(value) < least:
        raise ValueError(f"{name} = {value!r:.60}: expected a whole number of at least {least}")


def check_pair(name: str, value: object, expected: str) -> None:
    """Raise a ValueError if an argument is not a sequence of two values."""
    if not isinstance(value, Sequence) or len(value) != 2:
        raise ValueError(f"{name} = {value!r:.60}: expected {expected}")


def check_at_least(record: object, least: float, *names: str) -> None:
    """Raise a ValueError if one of the attributes `names` of `record` is below `least`."""
    _check_attributes(record, names, lambda value: value >= least, f"at least {least}")


def check_positive(record: object, *names: str) -> None:
    """Raise a ValueError if one of the attributes `names` of `record` is neither positive nor None."""
    _check_attributes(record, names, lambda value: value is None or value > 0, "more than 0")


def check_shares(record: object, *names: str) -> None:
    """Raise a ValueError if one of the attributes `names` of `record` is not in [0, 1]."""
    _check_attributes(record, names, lambda value: 0 <= value <= 1, "a share in [0, 1]")


def _check_attributes(
    record: object, names: Sequence[str], holds: Callable[[Any], bool], expected: str
) -> None:
    for name in names:
        value = getattr(record, name)
        if not holds(value):
            raise ValueError(f"{name} = {value!r}: expected {expected}")
