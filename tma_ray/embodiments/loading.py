"""Loading of bodies from their data files."""

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

from tma_ray.embodiments.base import Embodiment, EmbodimentError, GripSensor, Joint, Part, Point, Polygon
from tma_ray.support.component_names import join_name, nearest, split_name
from tma_ray.support.decoding import MOST_TEXT_BYTES, check_file
from tma_ray.support.quantities import BODY_SIZE, TORQUE

Entry = dict[str, Any]

PLACES = ("position", "anchor", "anchor_b")  # fields that move with a copy
LAST = "last"  # value of `head`: true in the last copy only

NUMBER = re.compile(r"\{(\d*)k([+-]\d+)?\}")
"""Number of a copy in names, k = 1, 2, ...: as in {k}, {2k-1} or {k+1}."""


@dataclass(frozen=True)
class Repeat:
    """A section whose entries are written out once per copy.

    Attributes:
        parameter: name of the number of copies.
        count: that number, unless another is asked for.
        at_most: largest number.
        parts: entries of parts, whose texts may hold the copy's number.
        joints: entries of joints, whose texts may hold it too.
        links: entries of joints between copies k and k + 1.
        grip_sensors: entries of grip sensors, whose texts may hold it too.
        step: distance between the copies, in m; they are centred on the place written down.
    """

    parameter: str
    count: int
    at_most: int
    parts: list[Entry]
    joints: list[Entry]
    links: list[Entry]
    grip_sensors: list[Entry]
    step: tuple[float, float] = (0.0, 0.0)

    def check(self, count: object) -> None:
        """Check a number of copies; 3.0 is as whole as 3.

        Raises:
            ValueError: it is not a whole number from 1 to `at_most`.
        """
        is_number = isinstance(count, int | float) and not isinstance(count, bool)
        if not is_number or count not in range(1, self.at_most + 1):
            raise ValueError(f"{self.parameter} {count!r} must be a whole number from 1 to {self.at_most}")


def repeats(data: Mapping[str, Any]) -> dict[str, Repeat]:
    """Return the sections of a body's file, by parameter.

    Raises:
        ValueError: a section without a parameter, or with one that makes no sense.
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
    """Return a body's file with its repeated sections written out `counts` times."""
    parts, joints = list(data.get("parts", [])), list(data.get("joints", []))
    sensors = list(data.get("grip_sensors", []))
    for name, section in repeats(data).items():
        count = counts[name]
        for number in range(1, count + 1):
            parts += [_copied(entry, section, number, count) for entry in section.parts]
            joints += [_copied(entry, section, number, count) for entry in section.joints]
            sensors += [_copied(entry, section, number, count) for entry in section.grip_sensors]
        for number in range(1, count):
            joints += [_copied(entry, section, number, count - 1) for entry in section.links]
    others = {key: value for key, value in data.items() if key != "repeat"}
    return others | {"parts": parts, "joints": joints, "grip_sensors": sensors}


def _copied(entry: Entry, section: Repeat, number: int, count: int) -> Entry:
    """Return copy `number` of `count`."""

    def numbered(match: re.Match[str]) -> str:
        return str(int(match[1] or 1) * number + int(match[2] or 0))

    copy = {
        key: NUMBER.sub(numbered, value) if isinstance(value, str) else value for key, value in entry.items()
    }
    shift = number - 1 - (count - 1) / 2
    for key in PLACES & copy.keys():
        copy[key] = [place + shift * step for place, step in zip(copy[key], section.step, strict=True)]
    if copy.get("head") == LAST:
        copy["head"] = number == count
    return copy


def body_parameters(text: str) -> tuple[str, dict[str, float]]:
    """Return a body's name or path without its parameters, and the parameters.

    Raises:
        ValueError: a parameter that is not a number, or is given twice.

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
    """Return `body` with all lengths multiplied by `size`; densities and torques stay.

    Raises:
        ValueError: a size that is not over 0, or absurd.
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
        ValueError: a torque that is not over 0, or absurd.
    """
    TORQUE.check("motor_torque", torque)
    joints = [joint if joint.passive else replace(joint, motor_torque=float(torque)) for joint in body.joints]
    return replace(body, joints=tuple(joints))


SIZE, MOTOR_TORQUE = "size", "motor_torque"
SURVIVAL = ("steps_survivable_under_water", "steps_survivable_outside_water")
ENTRIES = ("parts", "joints", "grip_sensors", "repeat")  # fields of a body's file that are lists of sections
LARGEST = 1e9  # bound of every number in a body's file

_FOLDER = resources.files("tma_ray.embodiments") / "data"

_TYPES = {kind: get_type_hints(kind) for kind in (Embodiment, Part, Joint, GripSensor)}

EVERY_BODY = (SIZE, MOTOR_TORQUE, *SURVIVAL)  # parameters that every body has


def embodiment_names() -> list[str]:
    """Return the names of the bodies shipped with tma_ray, sorted."""
    return sorted(
        path.name.removesuffix(".toml") for path in _FOLDER.iterdir() if path.name.endswith(".toml")
    )


def load_embodiment(name_or_path: str | Path, **parameters: float) -> Embodiment:
    """Return a body by name, or from a TOML file laid out as those in `tma_ray/embodiments/data`.

    Args:
        name_or_path: the name or the path, which may end with parameters.
        parameters: differences from the file: `size` (a factor of all lengths), `motor_torque` (of
            every motor, in N m), `steps_survivable_under_water` and `steps_survivable_outside_water` (time
            steps), and the number of copies of each repeated section.

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
    return _parse(_FOLDER / f"{name}.toml", dict(settings))


def _parse(path: Traversable, settings: Mapping[str, float]) -> Embodiment:
    """Return the body of a file with `settings`; its name includes those that differ from the defaults."""
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
    """Return the body of a file's contents with `settings`, under the file's name."""
    for name in ENTRIES:
        sections_of = data.get(name, [])
        if not isinstance(sections_of, list) or not all(isinstance(entry, dict) for entry in sections_of):
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
    """Return the fields of an entry as `kind` declares them; nested lists of entries are left unchanged."""
    types = _TYPES[kind]
    vertices = {"shape": "vertices"} if kind is Part else {}
    names = {field.name: vertices.get(field.name, field.name) for field in fields(kind)}
    given = {("shape" if key in vertices.values() else key): value for key, value in entry.items()}
    for name in sorted(given.keys() - names.keys()):
        hint = nearest(name, names.values())
        raise ValueError(f"{what}: unknown field {name!r}: {hint}known: {', '.join(names.values())}")
    required = {field.name for field in fields(kind) if field.default is MISSING}
    for name in sorted(required - given.keys()):
        raise ValueError(f"{what}: field {names[name]!r} is missing")
    decoded = {}
    for name, value in given.items():
        label = f"{what}: {names[name]} {value!r:.80}"
        if not _is_bounded(value):
            raise ValueError(f"{label}: expected numbers within ±{LARGEST:g}")
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
    """Return True if numbers in `value` are finite and of a plausible size."""
    if isinstance(value, list):
        return all(map(_is_bounded, value))
    return not isinstance(value, (int, float)) or abs(value) <= LARGEST
