"""Loading of bodies from their TOML files."""

import re
import tomllib
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, replace
from enum import StrEnum
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, get_type_hints

import msgspec

from tma_ray.embodiments.embodiment import (
    Embodiment,
    EmbodimentError,
    GripSensor,
    Joint,
    Part,
    Point,
    Polygon,
)
from tma_ray.support.component_names import join_name, nearest, split_name
from tma_ray.support.decoding import MOST_TEXT_BYTES, check_file
from tma_ray.support.quantities import BODY_SIZE, TORQUE

Entry = dict[str, Any]

POSITION_FIELDS = ("position", "anchor", "anchor_b")  # fields of an entry that are shifted in copies
LAST = "last"  # value of `head` that means true in the last copy, false in others
NUMBER = re.compile(r"\{(\d*)k([+-]\d+)?\}")  # placeholders for a copy's number k: {k}, {2k-1}, {k+1}


@dataclass(frozen=True)
class Repeat:
    """Repeated section of a body's file, with its entries and number of copies."""

    parameter: str  # name of the parameter that sets the number of copies
    count: int  # default number of copies
    at_most: int  # largest number of copies
    parts: list[Entry]  # entries of parts
    joints: list[Entry]  # entries of joints
    links: list[Entry]  # entries of joints between copies k and k + 1
    grip_sensors: list[Entry]  # entries of grip sensors
    # offset in m from one copy to the next; the copies are centred on the given position
    step: tuple[float, float] = (0.0, 0.0)

    def check(self, count: object) -> None:
        """Check that the number of copies is a whole number from 1 to `at_most`."""
        is_number = isinstance(count, int | float) and not isinstance(count, bool)
        if not is_number or count not in range(1, self.at_most + 1):
            raise ValueError(f"{self.parameter} {count!r} must be a whole number from 1 to {self.at_most}")


def repeats(data: Mapping[str, Any]) -> dict[str, Repeat]:
    """Return the repeated sections of a body's file, by parameter.

    Raises:
        ValueError: if a section is invalid or its parameter is repeated.
    """
    sections: dict[str, Repeat] = {}
    for entry in data.get("repeat", []):
        values = {"parts": [], "joints": [], "links": [], "grip_sensors": []} | entry
        unknown = sorted(entry.keys() - {field.name for field in fields(Repeat)})
        if unknown:
            raise ValueError(f"repeat {entry.get('parameter')!r}: unknown field {unknown[0]!r}")
        try:
            section = msgspec.convert(values, Repeat, strict=True)
        except msgspec.ValidationError as error:
            raise ValueError(f"repeat {entry.get('parameter')!r}: {error}") from error
        section.check(section.count)
        if section.parameter in sections:
            raise ValueError(f"repeat {section.parameter!r} is there more than once; names must differ")
        sections[section.parameter] = section
    return sections


def expand_repeats(data: Mapping[str, Any], counts: Mapping[str, int]) -> dict[str, Any]:
    """Return the contents of a body's file, with repeated sections expanded to `counts` copies."""
    expanded = {name: list(data.get(name, [])) for name in ("parts", "joints", "grip_sensors")}
    for parameter, section in repeats(data).items():
        count = counts[parameter]
        for number in range(1, count + 1):
            for name, entries in expanded.items():
                entries += [_copied(entry, section, number, count) for entry in getattr(section, name)]
        for number in range(1, count):
            expanded["joints"] += [_copied(entry, section, number, count - 1) for entry in section.links]
    return {key: value for key, value in data.items() if key != "repeat"} | expanded


def _copied(entry: Entry, section: Repeat, number: int, count: int) -> Entry:
    """Return `entry` renumbered and shifted for copy `number` of `count` of its repeated section."""

    def numbered(match: re.Match[str]) -> str:
        return str(int(match[1] or 1) * number + int(match[2] or 0))

    copy = {
        key: NUMBER.sub(numbered, value) if isinstance(value, str) else value for key, value in entry.items()
    }
    shift = number - 1 - (count - 1) / 2
    for key in POSITION_FIELDS & copy.keys():
        copy[key] = [value + shift * step for value, step in zip(copy[key], section.step, strict=True)]
    if copy.get("head") == LAST:
        copy["head"] = number == count
    return copy


def body_parameters(text: str) -> tuple[str, dict[str, float]]:
    """Split `text` into the name or path of a body and its parameters.

    Raises:
        ValueError: if a parameter is not a number, or is given twice.

    Examples:
        >>> body_parameters("spider:pairs_of_legs=3:size=1.2")
        ('spider', {'pairs_of_legs': 3, 'size': 1.2})
    """
    name, settings = split_name(text)
    numbers: dict[str, float] = {}
    for key, value in settings.items():
        try:
            numbers[key] = int(value) if value.isdecimal() else float(value)
        except ValueError:
            raise ValueError(f"parameter {key}={value}: expected a number") from None
    return name, numbers


def resized(body: Embodiment, size: float) -> Embodiment:
    """Return `body` with all lengths multiplied by `size`, and with the same densities and torques.

    Raises:
        ValueError: if the size is not positive, or implausible.
    """
    BODY_SIZE.check("size", size)

    def times(point: Point) -> Point:
        return point[0] * size, point[1] * size

    parts = [
        replace(part, shape=Polygon(tuple(map(times, part.shape.vertices))), position=times(part.position))
        for part in body.parts
    ]
    joints = [
        replace(
            joint,
            anchor=times(joint.anchor),
            anchor_b=None if joint.anchor_b is None else times(joint.anchor_b),
        )
        for joint in body.joints
    ]
    sensors = [
        replace(sensor, position=times(sensor.position), radius=sensor.radius * size)
        for sensor in body.grip_sensors
    ]
    return replace(
        body,
        spawn_height=body.spawn_height * size,
        parts=tuple(parts),
        joints=tuple(joints),
        grip_sensors=tuple(sensors),
    )


def with_motor_torque(body: Embodiment, torque: float) -> Embodiment:
    """Return `body` with the largest torque of every motor set to `torque` N m.

    Raises:
        ValueError: if the torque is not positive, or implausible.
    """
    TORQUE.check("motor_torque", torque)
    joints = [joint if joint.passive else replace(joint, motor_torque=float(torque)) for joint in body.joints]
    return replace(body, joints=tuple(joints))


SIZE, MOTOR_TORQUE = "size", "motor_torque"
SURVIVAL = ("steps_survivable_under_water", "steps_survivable_outside_water")
ENTRIES = ("parts", "joints", "grip_sensors", "repeat")  # fields that are lists of sections
LARGEST_NUMBER = 1e9  # bound on the absolute value of every number in a body's file

_FOLDER = resources.files("tma_ray.embodiments") / "data"

_TYPES = {kind: get_type_hints(kind) for kind in (Embodiment, Part, Joint, GripSensor)}

EVERY_BODY = (SIZE, MOTOR_TORQUE, *SURVIVAL)  # parameters of every body


def embodiment_names() -> list[str]:
    """Return the names of the bodies shipped with tma_ray, sorted."""
    return sorted(
        path.name.removesuffix(".toml") for path in _FOLDER.iterdir() if path.name.endswith(".toml")
    )


def load_embodiment(name_or_path: str | Path, **parameters: float) -> Embodiment:
    """Load a body by name, or from a TOML file in the format of `tma_ray/embodiments/data`.

    Args:
        name_or_path: name or path, which may end with parameters.
        parameters: differences from the file: `size` (a factor of all lengths), `motor_torque` (of
            every motor, in N m), `steps_survivable_under_water` and `steps_survivable_outside_water` (time
            steps), and the number of copies of each repeated section.

    Raises:
        EmbodimentError: if a name or parameter is unknown, or the file or the body is invalid.

    Examples:
        >>> load_embodiment("spider").action_size, load_embodiment("spider", pairs_of_legs=3).action_size
        (12, 18)
        >>> load_embodiment("spider:pairs_of_legs=3") == load_embodiment("spider", pairs_of_legs=3)
        True
    """
    try:
        name, settings = body_parameters(str(name_or_path))
    except ValueError as error:
        raise EmbodimentError(f"embodiment {str(name_or_path)!r}: {error}") from error
    settings |= parameters
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
    return _parse(_FOLDER / f"{name}.toml", dict(settings))


def _parse(path: Traversable, settings: Mapping[str, float]) -> Embodiment:
    """Load the body from `path` with `settings` applied; its name includes the settings that change it."""
    try:
        if isinstance(path, Path):
            check_file(path, MOST_TEXT_BYTES)
        data = tomllib.loads(path.read_text(encoding="utf-8-sig"))
        body = _variant(data, settings)
        different = {
            name: value
            for name, value in settings.items()
            if body != _variant(data, {other: settings[other] for other in settings if other != name})
        }
        return replace(body, name=join_name(body.name, different))
    except EmbodimentError:
        raise
    except (OSError, tomllib.TOMLDecodeError, TypeError, ValueError, RecursionError) as error:
        raise EmbodimentError(f"{path}: {error}") from error


def _variant(data: dict[str, Any], settings: Mapping[str, float]) -> Embodiment:
    """Build the body described by `data`, a parsed file, with `settings` applied but its name unchanged."""
    for name in ENTRIES:
        tables = data.get(name, [])
        if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
            raise ValueError(f"{name} {data[name]!r:.80}: expected sections, as in [[{name}]]")
    sections = repeats(data)
    counts = {name: section.count for name, section in sections.items()}
    for name, value in settings.items():
        if name in sections:
            sections[name].check(value)
            counts[name] = int(value)
        elif name not in EVERY_BODY:
            names = (*sections, *EVERY_BODY)
            raise ValueError(f"unknown parameter {name!r}: {nearest(name, names)}known: {', '.join(names)}")
    entries = expand_repeats(data, counts)
    values = _decoded("body", entries, Embodiment)
    values |= {name: settings[name] for name in SURVIVAL if name in settings}
    values["parts"] = tuple(
        Part(**_decoded(f"part {entry.get('name')!r}", entry, Part)) for entry in entries["parts"]
    )
    values["joints"] = tuple(
        Joint(**_decoded(f"joint {entry.get('part_a')!r} to {entry.get('part_b')!r}", entry, Joint))
        for entry in entries["joints"]
    )
    values["grip_sensors"] = tuple(
        GripSensor(**_decoded(f"grip sensor {entry.get('name')!r}", entry, GripSensor))
        for entry in entries["grip_sensors"]
    )
    body = Embodiment(**values)
    if SIZE in settings:
        body = resized(body, settings[SIZE])
    if MOTOR_TORQUE in settings:
        body = with_motor_torque(body, settings[MOTOR_TORQUE])
    return body


def _decoded(
    what: str, entry: dict[str, Any], kind: type[Embodiment | Part | Joint | GripSensor]
) -> dict[str, Any]:
    """Convert the fields of an entry to the types declared in `kind`, except nested lists of entries."""
    types = _TYPES[kind]
    vertices = {"shape": "vertices"} if kind is Part else {}
    names = {field.name: vertices.get(field.name, field.name) for field in fields(kind)}
    entry = {("shape" if key in vertices.values() else key): value for key, value in entry.items()}
    for name in sorted(entry.keys() - names.keys()):
        hint = nearest(name, names.values())
        raise ValueError(f"{what}: unknown field {name!r}: {hint}known: {', '.join(names.values())}")
    required = {field.name for field in fields(kind) if field.default is MISSING}
    for name in sorted(required - entry.keys()):
        raise ValueError(f"{what}: field {names[name]!r} is missing")
    decoded = {}
    for name, value in entry.items():
        label = f"{what}: {names[name]} {value!r:.80}"
        if not _is_bounded(value):
            raise ValueError(f"{label}: expected numbers within ±{LARGEST_NUMBER:g}")
        try:
            if name == "shape":
                decoded[name] = Polygon(msgspec.convert(value, tuple[Point, ...]))
            else:
                decoded[name] = value if name in ENTRIES else msgspec.convert(value, types[name])
        except msgspec.ValidationError as error:
            if isinstance(types[name], type) and issubclass(types[name], StrEnum):
                raise ValueError(f"{label} must be one of {', '.join(types[name])}") from error
            raise ValueError(f"{label}: {error}") from error
        except ValueError as error:
            raise ValueError(f"{what}: {error}") from error
    return decoded


def _is_bounded(value: object) -> bool:
    """Return True if all numbers in `value` are within ±LARGEST_NUMBER."""
    if isinstance(value, list):
        return all(map(_is_bounded, value))
    return not isinstance(value, (int, float)) or abs(value) <= LARGEST_NUMBER
