"""Parsing of components' settings (hyper-parameters, options) into typed values.

A component is a class or function, mostly a dataclass, whose annotated parameters are its settings. It may
declare ``presets: ClassVar[Mapping[str, Mapping[str, Any]]]``, named sets of values for the key ``preset``.
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

PRESET = "preset"  # setting that selects one of a component's `presets`

_LISTS: Mapping[Any, Callable[..., Any]] = {
    tuple: tuple,
    list: list,
    collections.abc.Sequence: tuple,
    set: set,
    frozenset: frozenset,
    collections.abc.Set: frozenset,
}
"""Constructor for each annotated collection type."""

_MAPPINGS = (dict, collections.abc.Mapping)
_UNFIT = object()  # stands for a value that does not match its annotation
_ANYTHING = (Any, inspect.Parameter.empty)
_CONSTANTS = {"true": True, "false": False, "none": None}


class Parameter(NamedTuple):
    """Type and default of a setting; the default is `inspect.Parameter.empty` if there is none."""

    annotation: Any
    default: Any


def parameters_of(component: Callable[..., Any]) -> dict[str, Parameter]:
    """Return the keyword parameters of `component`.

    Annotations that cannot be evaluated, such as imports for type checkers only, count as `Any`.
    """
    return dict(_parameters(component))


@cache  # cached, since plans of many cells repeat the same components
def _parameters(component: Callable[..., Any]) -> dict[str, Parameter]:
    is_record = dataclasses.is_dataclass(component)
    try:
        function = component if is_record or not isinstance(component, type) else component.__init__  # type: ignore[misc]
        hints = get_type_hints(function)
    except NameError:
        hints = {}
    parameters = {
        name: Parameter(hints.get(name, Any), parameter.default)
        for name, parameter in inspect.signature(component).parameters.items()
        if parameter.kind in (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    }
    for field in dataclasses.fields(component) if is_record else ():  # type: ignore[arg-type]
        if field.name in parameters and field.default_factory is not dataclasses.MISSING:
            parameters[field.name] = parameters[field.name]._replace(default=field.default_factory())
    return parameters


def parse_settings(
    component: Callable[..., Any],
    text: Mapping[str, str],
    values: Mapping[str, Any] | None = None,
    kind: str = "hyper-parameter",
) -> dict[str, Any]:
    """Return the settings of `component` as typed values, with presets expanded.

    Explicit values override those of a preset. JSON values are accepted: lists for tuples, whole numbers for
    floats.

    Args:
        component: class or function with the settings.
        text: settings as text, from a name.
        values: further settings.
        kind: word for a setting in error messages.

    Raises:
        ValueError: if a key or preset is unknown, a value has a wrong type, or `text` and `values` disagree.
    """
    check_type(f"{kind}s", values or {}, Mapping, "values by name, as in {'batch_size': 100}")
    presets: Mapping[str, Mapping[str, Any]] = getattr(component, "presets", {})
    parameters = parameters_of(component)
    types = {key: parameter.annotation for key, parameter in parameters.items()}
    types |= {PRESET: str} if presets else {}

    def typed(key: str, value: Any, *, is_text: bool = False) -> Any:
        if key not in types:
            listed = ", ".join(parameters) or "none"
            raise ValueError(f"unknown {kind} {key!r}: {nearest(key, parameters)}known: {listed}")
        if key == PRESET and presets:
            if value not in presets:
                hint = nearest(str(value), presets)
                raise ValueError(f"unknown preset {value!r}: {hint}known: {', '.join(presets)}")
            return value
        return coerce(key, _from_text(value, types[key]) if is_text else value, types[key], kind)

    settings = {key: typed(key, value, is_text=True) for key, value in text.items()}
    for key, value in (values or {}).items():
        checked = typed(key, value)
        if key != PRESET and settings.get(key, checked) != checked:
            raise ValueError(f"{kind} {key} is given as {settings[key]!r} and as {checked!r}; give it once")
        settings[key] = checked
    preset = settings.pop(PRESET, None) if presets else None
    return {key: typed(key, value) for key, value in (presets[preset] if preset else {}).items()} | settings


def non_defaults(component: Callable[..., Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the `values` that differ from a component's defaults, with a preset if that is shorter."""
    defaults = {name: parameter.default for name, parameter in parameters_of(component).items()}
    complete = defaults | dict(values)
    presets: Mapping[str, Mapping[str, Any]] = getattr(component, "presets", {})
    options: list[tuple[dict[str, Any], dict[str, Any]]] = []
    for preset in (None, *presets):
        base = defaults | dict(presets[preset] if preset else {})
        others = {key: value for key, value in complete.items() if to_json(value) != to_json(base[key])}
        options.append(({PRESET: preset} if preset else {}, others))
    named, others = min(options, key=lambda option: len(option[1]))
    return named | others


def config_dict(record: Any) -> dict[str, Any]:
    """Return the constructor arguments of a dataclass, including defaults, as JSON values.

    Fields in its attribute `absent_at_default` are left out at their defaults, so that fields added later do
    not change run ids.

    Raises:
        ValueError: if an argument is not a field, or a value has no JSON form.
    """
    later: frozenset[str] = getattr(record, "absent_at_default", frozenset())
    fields = {field.name: field for field in dataclasses.fields(record) if field.init}
    for name in parameters_of(type(record)):
        if name not in fields:
            raise ValueError(
                f"{type(record).__name__}: hyper-parameter {name} is not a field of the dataclass, and would "
                f"not be kept with results: declare it as a field"
            )
    return {
        name: json_value(name, getattr(record, name), f"{type(record).__name__}: hyper-parameter")
        for name, field in fields.items()
        if not (name in later and getattr(record, name) == field.default)
    }


def to_json(value: Any) -> Any:
    """Return `value` with enums, paths, numpy scalars, tuples and sets converted to JSON types.

    Enums become their value if that is a string or a number, else their name.
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
    """Convert `value`, which may come from JSON, to the type of its annotation.

    Raises:
        ValueError: if the value has another type, or is not finite.
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
    result = _collection(key, value, annotation, kind) if several else _scalar(value, annotation)
    if result is _UNFIT:
        raise ValueError(f"{kind} {key} = {value!r}: expected {_expected(annotation)}")
    return result


def _choices(annotation: Any) -> dict[str, Any]:
    """Return the values of a literal or enum type by their string forms, or {} for other types."""
    if get_origin(annotation) is Literal:
        return {text_of(to_json(choice)): choice for choice in get_args(annotation)}
    if isinstance(annotation, type) and issubclass(annotation, Enum):
        return {text_of(to_json(choice)): choice for choice in annotation}
    return {}


def _chosen(key: str, value: Any, choices: Mapping[str, Any], kind: str) -> Any:
    """Return the item of `choices` that equals `value` or its JSON form."""
    for choice in choices.values():
        if value is choice or (type(to_json(choice)) is type(value) and to_json(choice) == value):
            return choice
    hint = nearest(str(value), choices)
    raise ValueError(f"{kind} {key} = {value!r}: {hint}expected one of {', '.join(choices)}")


def _collection(key: str, value: Any, annotation: Any, kind: str) -> Any:
    """Convert `value` to the annotated collection, or return `_UNFIT` if it does not match."""
    origin = get_origin(annotation) or annotation
    if origin in _MAPPINGS and isinstance(value, collections.abc.Mapping):
        of_keys, of_values = get_args(annotation) or (Any, Any)
        pairs = [(name, coerce(key, item, of_values, kind)) for name, item in value.items()]
        return {coerce(key, name, of_keys, kind): item for name, item in pairs}
    if origin in _LISTS and isinstance(value, (list, tuple, set, frozenset)):
        annotations = _item_annotations(annotation, len(value))
        if len(annotations) == len(value):
            items = zip(value, annotations, strict=True)
            return _LISTS[origin](coerce(key, item, of_item, kind) for item, of_item in items)
    return _UNFIT


def _scalar(value: Any, annotation: Any) -> Any:
    """Convert `value` to the annotated scalar type, or return `_UNFIT` if it does not match."""
    number = _number_kind(annotation)
    if number is not None:
        fits = isinstance(value, Integral if number is int else Real) and not isinstance(value, bool)
        convert = number if inspect.isabstract(annotation) else annotation
        return convert(value) if fits and math.isfinite(value) else _UNFIT
    if not isinstance(annotation, type):
        return _UNFIT
    from_text = issubclass(annotation, (PurePath, np.str_)) and isinstance(value, str)
    if from_text or (issubclass(annotation, np.bool_) and isinstance(value, bool)):
        return annotation(value)
    return value if isinstance(value, annotation) else _UNFIT


def _one_of(key: str, value: Any, choices: tuple[Any, ...], kind: str) -> Any:
    """Convert `value` to the first of the types `choices` that accepts it."""
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
    """Return the annotations of `count` items of a collection, or of all items of a fixed-length tuple."""
    arguments = get_args(annotation)
    if get_origin(annotation) is tuple and arguments[1:] != (Ellipsis,):
        return arguments
    return (arguments[:1] or (Any,)) * count


def _number_kind(annotation: Any) -> type | None:
    """Return int or float for a number type (including numpy's), or None for other types."""
    if annotation in (int, float, Integral, Real):
        return int if annotation in (int, Integral) else float
    if isinstance(annotation, type) and issubclass(annotation, (np.integer, np.floating)):
        return int if issubclass(annotation, np.integer) else float
    return None


def _from_text(text: str, annotation: Any) -> Any:
    """Parse `text` as the type of `annotation`, or return it unchanged if it cannot be parsed."""
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
    """Parse `text` as the first of several types that accepts it."""
    if text.lower() == "none" and type(None) in annotations:
        return None
    values = (_from_text(text, choice) for choice in annotations if choice is not type(None))
    return next((value for value in values if not isinstance(value, str)), text)


def _items_from_text(text: str, annotation: Any) -> Any:
    """Parse `text` as a list, or as JSON; return it unchanged if a mapping is expected but it is not JSON."""
    if text[:1] in ("[", "{"):
        with suppress(ValueError):
            return json.loads(text)
    if (get_origin(annotation) or annotation) in _MAPPINGS:
        return text
    items = text.split(LIST_SEPARATOR)
    annotations = _item_annotations(annotation, len(items))
    if len(annotations) != len(items):
        return items
    return [_from_text(*pair) for pair in zip(items, annotations, strict=True)]


def _number(text: str) -> Any:
    """Parse `text` as a number (an integer if it is whole), or return it unchanged."""
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
    """Return `value` converted to JSON types.

    Raises:
        ValueError: if it has no JSON form.
    """
    result = to_json(value)
    try:
        json.dumps(result, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{kind} {key} = {value!r}: expected a value that JSON has: text, finite numbers, booleans, "
            f"none, enums, paths, and lists or mappings of these"
        ) from error
    return result
