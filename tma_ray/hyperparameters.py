"""Hyper-parameters and other settings of a part as typed values: parsed, checked, presets expanded.

A part is what has settings: a class or function whose annotated parameters they are, mostly a dataclass. It
may declare ``presets: ClassVar[Mapping[str, Mapping[str, Any]]]``: names for several values at once, chosen
by the key ``preset``.
"""

import collections.abc
import dataclasses
import inspect
import json
import math
import types
from collections.abc import Callable, Mapping
from enum import StrEnum
from functools import cache
from numbers import Integral, Real
from typing import Any, NamedTuple, Union, get_args, get_origin, get_type_hints

from tma_ray.arguments import check_kind
from tma_ray.part_names import LIST_SEPARATOR, nearest

PRESET = "preset"  # key that stands for several values at once, as a part's attribute `presets` has them

_LISTS = (tuple, list, collections.abc.Sequence)
_ANYTHING = (Any, inspect.Parameter.empty)
_CONSTANTS = {"true": True, "false": False, "none": None}


class Parameter(NamedTuple):
    """A setting that a part has: the type of its value and its default, `inspect.Parameter.empty` if none."""

    annotation: Any
    default: Any


def parameters_of(part: Callable[..., Any]) -> dict[str, Parameter]:
    """Return the settings that the constructor of `part` takes by keyword.

    An annotation that cannot be evaluated, such as one imported for type checkers only, counts as any type.
    """
    return dict(_parameters(part))


@cache  # a plan of many cells asks for the same parts again and again
def _parameters(part: Callable[..., Any]) -> dict[str, Parameter]:
    is_record = dataclasses.is_dataclass(part)
    try:
        function = part if is_record or not isinstance(part, type) else part.__init__  # type: ignore[misc]
        hints = get_type_hints(function)
    except NameError:
        hints = {}
    found = {
        name: Parameter(hints.get(name, Any), parameter.default)
        for name, parameter in inspect.signature(part).parameters.items()
        if parameter.kind in (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    }
    for field in dataclasses.fields(part) if is_record else ():  # type: ignore[arg-type]
        if field.name in found and field.default_factory is not dataclasses.MISSING:
            found[field.name] = found[field.name]._replace(default=field.default_factory())
    return found


def parse_settings(
    part: Callable[..., Any],
    text: Mapping[str, str],
    given: Mapping[str, Any] | None = None,
    kind: str = "hyper-parameter",
) -> dict[str, Any]:
    """Return settings of `part` as typed values, with its preset expanded.

    Explicit values take precedence over those of a preset. Lists count as tuples and whole numbers as
    floats, so that values may come from JSON. Settings are `text` that follows a name, and `given` values;
    messages call one a `kind`.

    Raises:
        ValueError: an unknown key or preset (the message has the nearest known one), a value of another
            type, or a key with different values in `text` and in `given`.
    """
    check_kind(f"{kind}s", given or {}, Mapping, "values by name, as in {'batch_size': 100}")
    presets: Mapping[str, Mapping[str, Any]] = getattr(part, "presets", {})
    known = parameters_of(part)
    types = {key: parameter.annotation for key, parameter in known.items()} | (
        {PRESET: str} if presets else {}
    )

    def typed(key: str, value: Any, *, is_text: bool = False) -> Any:
        if key not in types:
            listed = ", ".join(known) or "none"
            raise ValueError(f"unknown {kind} {key!r}: {nearest(key, known)}known: {listed}")
        if key == PRESET and presets:
            if value not in presets:
                hint = nearest(str(value), presets)
                raise ValueError(f"unknown preset {value!r}: {hint}known: {', '.join(presets)}")
            return value
        return converted(key, _from_text(value, types[key]) if is_text else value, types[key], kind)

    values = {key: typed(key, value, is_text=True) for key, value in text.items()}
    for key, value in (given or {}).items():
        checked = typed(key, value)
        if key != PRESET and values.get(key, checked) != checked:
            raise ValueError(f"{kind} {key} is given as {values[key]!r} and as {checked!r}; give it once")
        values[key] = checked
    preset = values.pop(PRESET, None) if presets else None
    return {key: typed(key, value) for key, value in (presets[preset] if preset else {}).items()} | values


def differing(part: Callable[..., Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the shortest settings that give `values`: those that differ from the defaults of `part`.

    A preset is used where it leaves fewer settings, not counting itself.
    """
    defaults = {name: parameter.default for name, parameter in parameters_of(part).items()}
    complete = defaults | dict(values)
    presets: Mapping[str, Mapping[str, Any]] = getattr(part, "presets", {})
    ways: list[tuple[dict[str, Any], dict[str, Any]]] = []
    for preset in (None, *presets):
        base = defaults | dict(presets[preset] if preset else {})
        others = {key: value for key, value in complete.items() if plain(value) != plain(base[key])}
        ways.append(({PRESET: preset} if preset else {}, others))
    named, others = min(ways, key=lambda way: len(way[1]))
    return named | others


def identifying(part: Any) -> dict[str, Any]:
    """Return the constructor arguments of a dataclass, defaults included, as JSON values.

    Fields that its attribute `absent_at_default` names, those that came after the first runs, are left out
    where they have their default: runs keep the identity that they had before.
    """
    later: frozenset[str] = getattr(part, "absent_at_default", frozenset())
    return {
        field.name: plain(getattr(part, field.name))
        for field in dataclasses.fields(part)
        if field.init and not (field.name in later and getattr(part, field.name) == field.default)
    }


def plain(value: Any) -> Any:
    """Return a value in the types of JSON: enums as text, tuples as lists."""
    if isinstance(value, StrEnum):
        return value.value
    return [plain(item) for item in value] if isinstance(value, (tuple, list)) else value


def converted(key: str, value: Any, annotation: Any, kind: str = "hyper-parameter") -> Any:
    """Return `value` as its annotation has it.

    Raises:
        ValueError: a value of another type, or a number that is not finite.
    """
    if get_origin(annotation) in (Union, types.UnionType):
        return _one_of(key, value, get_args(annotation), kind)
    if annotation in _ANYTHING:
        return _json_value(key, value, kind)
    if get_origin(annotation) in _LISTS and isinstance(value, (list, tuple)):
        made = list if get_origin(annotation) is list else tuple
        return made(converted(key, item, get_args(annotation)[0], kind) for item in value)
    if annotation in (int, float):
        fits = isinstance(value, Integral if annotation is int else Real) and not isinstance(value, bool)
        if not (fits and math.isfinite(value)):
            raise ValueError(f"{kind} {key} = {value!r}: expected {_expected(annotation)}")
        return annotation(value)
    if isinstance(annotation, type) and issubclass(annotation, StrEnum) and isinstance(value, str):
        if value in list(annotation):
            return annotation(value)
        hint = nearest(value, annotation)
        raise ValueError(f"{kind} {key} = {value!r}: {hint}expected one of {', '.join(annotation)}")
    if isinstance(annotation, type) and isinstance(value, annotation):
        return value
    raise ValueError(f"{kind} {key} = {value!r}: expected {_expected(annotation)}")


def _one_of(key: str, value: Any, choices: tuple[Any, ...], kind: str) -> Any:
    """Return `value` as the first of the types `choices` that it has."""
    if value is None and type(None) in choices:
        return None
    for choice in choices:
        try:
            return converted(key, value, choice, kind)
        except ValueError:
            continue
    expected = " or ".join(_expected(choice) for choice in choices)
    raise ValueError(f"{kind} {key} = {value!r}: expected {expected}")


def _from_text(text: str, annotation: Any) -> Any:
    """Return the value of the type `annotation` that `text` names; `text` itself if it names none."""
    if get_origin(annotation) in (Union, types.UnionType):
        wanted = [choice for choice in get_args(annotation) if choice is not type(None)]
        if text.lower() == "none" and len(wanted) < len(get_args(annotation)):
            return None
        said = (_from_text(text, choice) for choice in wanted)
        return next((value for value in said if not isinstance(value, str)), text)
    if get_origin(annotation) in _LISTS:
        return [_from_text(item, get_args(annotation)[0]) for item in text.split(LIST_SEPARATOR)]
    constants = _CONSTANTS if annotation in _ANYTHING else {}
    if annotation is bool:
        constants = {"true": True, "false": False}
    if text.lower() in constants:
        return constants[text.lower()]
    return _number(text) if annotation in (int, float, *_ANYTHING) else text


def _number(text: str) -> Any:
    """Return the number in `text`, as an integer if it is whole; any other text unchanged."""
    try:
        return int(text)
    except ValueError:
        pass
    try:
        value = float(text)
    except ValueError:
        return text
    return int(value) if math.isfinite(value) and value == int(value) else value


def _expected(annotation: Any) -> str:
    if annotation is type(None):
        return "none"
    if get_origin(annotation) is not None:
        return str(annotation)
    return {"float": "finite float"}.get(name := getattr(annotation, "__name__", str(annotation)), name)


def _json_value(key: str, value: Any, kind: str) -> Any:
    try:
        json.dumps(value, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{kind} {key} = {value!r}: expected a value that JSON has") from error
    return value
