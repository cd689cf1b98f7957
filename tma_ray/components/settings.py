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
from contextlib import suppress
from enum import Enum, Flag
from functools import cache
from numbers import Integral, Real
from pathlib import PurePath
from typing import Any, Literal, NamedTuple, NewType, Union, get_args, get_origin, get_type_hints

import numpy as np

from tma_ray.support.component_names import LIST_SEPARATOR, nearest, text_of
from tma_ray.support.validation import check_type

PRESET = "preset"  # key that stands for several values at once, as a part's attribute `presets` has them

_LISTS: Mapping[Any, Callable[..., Any]] = {
    tuple: tuple,
    list: list,
    collections.abc.Sequence: tuple,
    set: set,
    frozenset: frozenset,
    collections.abc.Set: frozenset,
}
"""Types of several values, each with the one that is made for it."""

_MAPPINGS = (dict, collections.abc.Mapping)
_UNFIT = object()  # returned for a value of another type than its annotation
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
    check_type(f"{kind}s", given or {}, Mapping, "values by name, as in {'batch_size': 100}")
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
        return coerce(key, _from_text(value, types[key]) if is_text else value, types[key], kind)

    values = {key: typed(key, value, is_text=True) for key, value in text.items()}
    for key, value in (given or {}).items():
        checked = typed(key, value)
        if key != PRESET and values.get(key, checked) != checked:
            raise ValueError(f"{kind} {key} is given as {values[key]!r} and as {checked!r}; give it once")
        values[key] = checked
    preset = values.pop(PRESET, None) if presets else None
    return {key: typed(key, value) for key, value in (presets[preset] if preset else {}).items()} | values


def non_defaults(part: Callable[..., Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the shortest settings that give `values`: those that differ from the defaults of `part`.

    A preset is used where it leaves fewer settings, not counting itself.
    """
    defaults = {name: parameter.default for name, parameter in parameters_of(part).items()}
    complete = defaults | dict(values)
    presets: Mapping[str, Mapping[str, Any]] = getattr(part, "presets", {})
    ways: list[tuple[dict[str, Any], dict[str, Any]]] = []
    for preset in (None, *presets):
        base = defaults | dict(presets[preset] if preset else {})
        others = {key: value for key, value in complete.items() if to_json(value) != to_json(base[key])}
        ways.append(({PRESET: preset} if preset else {}, others))
    named, others = min(ways, key=lambda way: len(way[1]))
    return named | others


def config_dict(part: Any) -> dict[str, Any]:
    """Return the constructor arguments of a dataclass, defaults included, as JSON values.

    Fields that its attribute `absent_at_default` names, those that came after the first runs, are left out
    where they have their default: runs keep the identity that they had before.

    Raises:
        ValueError: an argument that is not a field, or a value that JSON does not have, by its name.
    """
    later: frozenset[str] = getattr(part, "absent_at_default", frozenset())
    fields = {field.name: field for field in dataclasses.fields(part) if field.init}
    for name in parameters_of(type(part)):
        if name not in fields:
            raise ValueError(
                f"{type(part).__name__}: hyper-parameter {name} is not a field of the dataclass, and would "
                f"not be kept with results: declare it as a field"
            )
    return {
        name: json_value(name, getattr(part, name), f"{type(part).__name__}: hyper-parameter")
        for name, field in fields.items()
        if not (name in later and getattr(part, name) == field.default)
    }


def to_json(value: Any) -> Any:
    """Return a value in the types of JSON as far as it has them.

    Enums become their value if that is text or a number, else their name; paths become text, numpy's scalars
    Python's, tuples and sets lists.
    """
    if isinstance(value, Enum):
        scalar = Flag, str, int, float
        return value.value if issubclass(type(value), scalar) else value.name
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, (set, frozenset)):
        return sorted(map(to_json, value), key=repr)
    if isinstance(value, collections.abc.Mapping):
        return {name: to_json(item) for name, item in value.items()}
    return [to_json(item) for item in value] if isinstance(value, (tuple, list)) else value


def coerce(key: str, value: Any, annotation: Any, kind: str = "hyper-parameter") -> Any:
    """Return `value`, or a value of JSON that stands for it, as its annotation has it.

    Raises:
        ValueError: a value of another type, or a number that is not finite.
    """
    origin = get_origin(annotation) or annotation
    if origin in (Union, types.UnionType):
        return _one_of(key, value, get_args(annotation), kind)
    if isinstance(annotation, NewType):
        return coerce(key, value, annotation.__supertype__, kind)
    if annotation in _ANYTHING:
        json_value(key, value, kind)
        return value
    if choices := _choices(annotation):
        return _chosen(key, value, choices, kind)
    several = origin in (*_LISTS, *_MAPPINGS)
    made = _collection(key, value, annotation, kind) if several else _scalar(value, annotation)
    if made is _UNFIT:
        raise ValueError(f"{kind} {key} = {value!r}: expected {_expected(annotation)}")
    return made


def _choices(annotation: Any) -> dict[str, Any]:
    """Return the values of a literal or an enum by their text; empty for other types."""
    if get_origin(annotation) is Literal:
        return {text_of(to_json(choice)): choice for choice in get_args(annotation)}
    if isinstance(annotation, type) and issubclass(annotation, Enum):
        return {text_of(to_json(choice)): choice for choice in annotation}
    return {}


def _chosen(key: str, value: Any, choices: Mapping[str, Any], kind: str) -> Any:
    """Return the one of `choices` that is `value`, or that it stands for in JSON."""
    for choice in choices.values():
        if value is choice or (type(to_json(choice)) is type(value) and to_json(choice) == value):
            return choice
    hint = nearest(str(value), choices)
    raise ValueError(f"{kind} {key} = {value!r}: {hint}expected one of {', '.join(choices)}")


def _collection(key: str, value: Any, annotation: Any, kind: str) -> Any:
    """Return a list, tuple, set or mapping with items as annotated; `_UNFIT` if `value` is none such."""
    origin = get_origin(annotation) or annotation
    if origin in _MAPPINGS and isinstance(value, collections.abc.Mapping):
        of_keys, of_values = get_args(annotation) or (Any, Any)
        pairs = [(name, coerce(key, item, of_values, kind)) for name, item in value.items()]
        return {coerce(key, name, of_keys, kind): item for name, item in pairs}
    if origin in _LISTS and isinstance(value, (list, tuple, set, frozenset)):
        annotations = _item_annotations(annotation, len(value))
        if len(annotations) == len(value):
            items = zip(value, annotations, strict=True)
            return _LISTS[origin](coerce(key, item, each, kind) for item, each in items)
    return _UNFIT


def _scalar(value: Any, annotation: Any) -> Any:
    """Return a number, text, path or other object as annotated; `_UNFIT` if `value` is none such."""
    number = _number_kind(annotation)
    if number is not None:
        fits = isinstance(value, Integral if number is int else Real) and not isinstance(value, bool)
        made = number if inspect.isabstract(annotation) else annotation
        return made(value) if fits and math.isfinite(value) else _UNFIT
    if not isinstance(annotation, type):
        return _UNFIT
    from_text = issubclass(annotation, (PurePath, np.str_)) and isinstance(value, str)
    if from_text or (issubclass(annotation, np.bool_) and isinstance(value, bool)):
        return annotation(value)
    return value if isinstance(value, annotation) else _UNFIT


def _one_of(key: str, value: Any, choices: tuple[Any, ...], kind: str) -> Any:
    """Return `value` as the first of the types `choices` that it has."""
    if value is None and type(None) in choices:
        return None
    for choice in choices:
        try:
            return coerce(key, value, choice, kind)
        except ValueError:
            continue
    expected = " or ".join(_expected(choice) for choice in choices)
    raise ValueError(f"{kind} {key} = {value!r}: expected {expected}")


def _item_annotations(annotation: Any, count: int) -> tuple[Any, ...]:
    """Return the annotations of `count` items of a list; as many as a tuple of fixed length has."""
    arguments = get_args(annotation)
    if get_origin(annotation) is tuple and arguments[1:] != (Ellipsis,):
        return arguments
    return (arguments[:1] or (Any,)) * count


def _number_kind(annotation: Any) -> type | None:
    """Return int or float for the type of a number, one of numpy's among them, else None."""
    if annotation in (int, float, Integral, Real):
        return int if annotation in (int, Integral) else float
    if isinstance(annotation, type) and issubclass(annotation, (np.integer, np.floating)):
        return int if issubclass(annotation, np.integer) else float
    return None


def _from_text(text: str, annotation: Any) -> Any:
    """Return the value of the type `annotation` that `text` names; `text` itself if it names none."""
    origin = get_origin(annotation) or annotation
    if origin in (Union, types.UnionType):
        return _one_from_text(text, get_args(annotation))
    if isinstance(annotation, NewType):
        return _from_text(text, annotation.__supertype__)
    if origin in (*_LISTS, *_MAPPINGS):
        return _items_from_text(text, annotation)
    if choices := _choices(annotation):
        return choices.get(text, choices.get(text.lower(), text))
    constants = _CONSTANTS if annotation in _ANYTHING else {}
    if annotation in (bool, np.bool_):
        constants = {"true": True, "false": False}
    if text.lower() in constants:
        return constants[text.lower()]
    return _number(text) if annotation in _ANYTHING or _number_kind(annotation) else text


def _one_from_text(text: str, annotations: tuple[Any, ...]) -> Any:
    """Return the value of the first of several types that `text` names."""
    if text.lower() == "none" and type(None) in annotations:
        return None
    said = (_from_text(text, choice) for choice in annotations if choice is not type(None))
    return next((value for value in said if not isinstance(value, str)), text)


def _items_from_text(text: str, annotation: Any) -> Any:
    """Return the list or mapping that `text` names; `text` itself for a mapping that is not JSON."""
    if text[:1] in ("[", "{"):
        with suppress(ValueError):
            return json.loads(text)
    if (get_origin(annotation) or annotation) in _MAPPINGS:
        return text
    items = text.split(LIST_SEPARATOR)
    annotations = _item_annotations(annotation, len(items))
    if len(annotations) != len(items):
        return items
    return [_from_text(item, each) for item, each in zip(items, annotations, strict=True)]


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


def json_value(key: str, value: Any, kind: str = "hyper-parameter") -> Any:
    """Return a value in the types of JSON, by which results are identified.

    Raises:
        ValueError: JSON does not have it.
    """
    made = to_json(value)
    try:
        json.dumps(made, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{kind} {key} = {value!r}: expected a value that JSON has: text, finite numbers, booleans, "
            f"none, enums, paths, and lists or mappings of these"
        ) from error
    return made
