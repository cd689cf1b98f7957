"""Reads bodies from their data files."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import MISSING, fields, replace
from enum import StrEnum
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, get_type_hints

import msgspec

from tma_ray.decoding import MOST_TEXT_BYTES, check_file
from tma_ray.embodiments.checks import EmbodimentError
from tma_ray.embodiments.embodiment import Embodiment
from tma_ray.embodiments.parts import GripSensor, Joint, Part
from tma_ray.embodiments.polygon import Point, Polygon
from tma_ray.embodiments.repeats import expand_repeats, repeats
from tma_ray.embodiments.variants import body_parameters, resized, with_motor_torque
from tma_ray.part_names import join_name, nearest

SIZE, MOTOR_TORQUE = "size", "motor_torque"
SURVIVAL = ("steps_survivable_under_water", "steps_survivable_outside_water")
ENTRIES = ("parts", "joints", "grip_sensors", "repeat")
"""Fields of a body's file that are lists of sections."""

LARGEST = 1e9
"""Bound of every number in a body's file."""

_TYPES = {kind: get_type_hints(kind) for kind in (Embodiment, Part, Joint, GripSensor)}

EVERY_BODY = (SIZE, MOTOR_TORQUE, *SURVIVAL)
"""Parameters that every body has."""


def embodiment_names() -> list[str]:
    """Returns the names of the bodies shipped with tma_ray, sorted."""
    return sorted(
        path.name.removesuffix(".toml") for path in _folder().iterdir() if path.name.endswith(".toml")
    )


def load_embodiment(name_or_path: str | Path, **parameters: float) -> Embodiment:
    """Returns a body by name, or from a TOML file laid out as those in `tma_ray/embodiments/data`.

    Args:
        name_or_path: the name or the path, which may end with parameters.
        parameters: what shall differ from the file: `size` (a factor of all lengths), `motor_torque` (of
            every motor, in N m), `steps_survivable_under_water` and `steps_survivable_outside_water` (time
            steps), and how often the file's repeated sections are written out.

    Raises:
        EmbodimentError: unknown name or parameter, unreadable file, or a body that cannot be built.

    Examples:
        >>> load_embodiment("spider").action_size, load_embodiment("spider", pairs_of_legs=3).action_size
        (12, 18)
        >>> load_embodiment("spider:pairs_of_legs=3") == load_embodiment("spider", pairs_of_legs=3)
        True
    """
    try:
        name, named = body_parameters(str(name_or_path))
    except ValueError as error:
        raise EmbodimentError(f"embodiment {str(name_or_path)!r}: {error}") from error
    settings = named | parameters
    if name.endswith(".toml"):
        return _parse(Path(name), settings)
    if name not in embodiment_names():
        hint = nearest(name, embodiment_names())
        raise EmbodimentError(
            f"unknown embodiment {name!r}: {hint}"
            f"known: {', '.join(embodiment_names())}, or the path of a .toml file"
        )
    return _shipped(name, tuple(sorted(settings.items())))


@cache
def _shipped(name: str, settings: tuple[tuple[str, float], ...]) -> Embodiment:
    return _parse(_folder() / f"{name}.toml", dict(settings))


def _folder() -> Traversable:
    return resources.files("tma_ray.embodiments") / "data"


def _parse(path: Traversable, settings: Mapping[str, float]) -> Embodiment:
    try:
        if isinstance(path, Path):
            check_file(path, MOST_TEXT_BYTES)
        return _built(tomllib.loads(path.read_text(encoding="utf-8")), settings)
    except EmbodimentError:
        raise
    except (OSError, tomllib.TOMLDecodeError, TypeError, ValueError, RecursionError) as error:
        raise EmbodimentError(f"{path}: {error}") from error


def _built(data: dict[str, Any], settings: Mapping[str, float]) -> Embodiment:
    """Returns the body of a file's contents with `settings`; its name tells those that make a difference."""
    body = _variant(data, settings)
    different = [
        name
        for name in settings
        if body != _variant(data, {other: value for other, value in settings.items() if other != name})
    ]
    return replace(body, name=join_name(body.name, {name: settings[name] for name in different}))


def _variant(data: dict[str, Any], settings: Mapping[str, float]) -> Embodiment:
    """Returns the body of a file's contents with `settings`, under the file's name."""
    for name in ENTRIES:
        if not _are_tables(data.get(name, [])):
            raise ValueError(f"{name} {data[name]!r:.80}: expected sections, as in [[{name}]]")
    sections = repeats(data)
    counts = {name: section.count for name, section in sections.items()}
    for name, value in settings.items():
        if name in sections:
            sections[name].check(value)
            counts[name] = int(value)
        elif name not in EVERY_BODY:
            known = ", ".join([*sections, *EVERY_BODY])
            hint = nearest(name, (*sections, *EVERY_BODY))
            raise ValueError(f"unknown parameter {name!r}: {hint}known: {known}")
    survival = {name: settings[name] for name in SURVIVAL if name in settings}
    body = _embodiment(expand_repeats(data, counts), survival)
    if SIZE in settings:
        body = resized(body, settings[SIZE])
    if MOTOR_TORQUE in settings:
        body = with_motor_torque(body, settings[MOTOR_TORQUE])
    return body


def _are_tables(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(entry, dict) for entry in value)


def _embodiment(data: dict[str, Any], survival: Mapping[str, float]) -> Embodiment:
    values = _decoded("body", data, Embodiment)
    return Embodiment(
        **{
            **values,
            **survival,
            "parts": tuple(_part(entry) for entry in data["parts"]),
            "joints": tuple(_joint(entry) for entry in data["joints"]),
            "grip_sensors": tuple(_grip_sensor(entry) for entry in data.get("grip_sensors", [])),
        }
    )


def _part(entry: dict[str, Any]) -> Part:
    what = f"part {entry.get('name')!r}"
    values = {("shape" if key == "vertices" else key): value for key, value in entry.items()}
    return Part(**_decoded(what, values, Part, {"shape": "vertices"}))


def _joint(entry: dict[str, Any]) -> Joint:
    return Joint(**_decoded(f"joint {entry.get('part_a')!r} to {entry.get('part_b')!r}", entry, Joint))


def _grip_sensor(entry: dict[str, Any]) -> GripSensor:
    return GripSensor(**_decoded(f"grip sensor {entry.get('name')!r}", entry, GripSensor))


def _decoded(
    what: str,
    entry: dict[str, Any],
    kind: type[Embodiment | Part | Joint | GripSensor],
    renamed: dict[str, str] | None = None,
) -> dict[str, Any]:
    """Returns the fields of an entry as `kind` declares them; lists of further entries stay as they are."""
    _check_fields(what, entry, kind, renamed)
    types, names = _TYPES[kind], renamed or {}
    decoded = {}
    for name, value in entry.items():
        label = f"{what}: {names.get(name, name)}"
        if not _is_bounded(value):
            raise ValueError(f"{label} {value!r:.80}: expected numbers within ±{LARGEST:g}")
        try:
            if name == "shape":
                decoded[name] = Polygon(msgspec.convert(value, tuple[Point, ...]))
            else:
                decoded[name] = value if name in ENTRIES else msgspec.convert(value, types[name])
        except msgspec.ValidationError as error:
            choices = f"must be one of {', '.join(types[name])}" if _is_choice(types[name]) else f": {error}"
            raise ValueError(f"{label} {value!r:.80} {choices}".replace(" : ", ": ")) from error
        except ValueError as error:
            raise ValueError(f"{what}: {error}") from error
    return decoded


def _is_choice(kind: object) -> bool:
    return isinstance(kind, type) and issubclass(kind, StrEnum)


def _is_bounded(value: object) -> bool:
    """Tells whether numbers in `value` are finite and none that only a slip of the pen makes."""
    if isinstance(value, list):
        return all(map(_is_bounded, value))
    return not isinstance(value, (int, float)) or abs(value) <= LARGEST


def _check_fields(
    what: str,
    entry: dict[str, Any],
    kind: type[Embodiment | Part | Joint | GripSensor],
    renamed: dict[str, str] | None = None,
) -> None:
    names = renamed or {}
    known = {field.name: names.get(field.name, field.name) for field in fields(kind)}
    required = {field.name for field in fields(kind) if field.default is MISSING}
    for name in sorted(entry.keys() - known.keys()):
        hint = nearest(name, known.values())
        raise ValueError(f"{what}: unknown field {name!r}: {hint}known: {', '.join(known.values())}")
    for name in sorted(required - entry.keys()):
        raise ValueError(f"{what}: field {known[name]!r} is missing")
