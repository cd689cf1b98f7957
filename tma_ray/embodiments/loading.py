"""Reads bodies from their data files."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping
from dataclasses import MISSING, fields, replace
from enum import StrEnum
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, TypeVar

from tma_ray.embodiments.checks import EmbodimentError
from tma_ray.embodiments.embodiment import BodyType, Embodiment, LidarLayout
from tma_ray.embodiments.parts import GripSensor, Joint, Part
from tma_ray.embodiments.polygon import Polygon
from tma_ray.embodiments.repeats import expand_repeats, repeats
from tma_ray.embodiments.variants import body_parameters, resized, with_motor_torque
from tma_ray.part_names import join_name

SIZE, MOTOR_TORQUE = "size", "motor_torque"
SURVIVAL = ("steps_survivable_under_water", "steps_survivable_outside_water")
EVERY_BODY = (SIZE, MOTOR_TORQUE, *SURVIVAL)
"""Parameters that every body has."""

Kind = TypeVar("Kind", bound=StrEnum)


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
        near = difflib.get_close_matches(name, embodiment_names(), n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
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
        return _built(tomllib.loads(path.read_text(encoding="utf-8")), settings)
    except EmbodimentError:
        raise
    except (OSError, tomllib.TOMLDecodeError, TypeError, ValueError) as error:
        raise EmbodimentError(f"{path}: {error}") from error


def _built(data: dict[str, Any], settings: Mapping[str, float]) -> Embodiment:
    """Returns the body of a file's contents with `settings`, which its name tells."""
    sections = repeats(data)
    counts = {name: section.count for name, section in sections.items()}
    for name, value in settings.items():
        if name in sections:
            sections[name].check(value)
            counts[name] = int(value)
        elif name not in EVERY_BODY:
            known = ", ".join([*sections, *EVERY_BODY])
            raise ValueError(f"unknown parameter {name!r}; known: {known}")
    survival = {name: settings[name] for name in SURVIVAL if name in settings}
    body = _embodiment(expand_repeats(data, counts) | survival)
    if SIZE in settings:
        body = resized(body, settings[SIZE])
    if MOTOR_TORQUE in settings:
        body = with_motor_torque(body, settings[MOTOR_TORQUE])
    return replace(body, name=join_name(body.name, settings))


def _embodiment(data: dict[str, Any]) -> Embodiment:
    _check_fields("body", data, Embodiment)
    return Embodiment(
        **{
            **data,
            "body_type": _one_of(BodyType, "body_type", data["body_type"]),
            "lidars": _one_of(LidarLayout, "lidars", data.get("lidars", LidarLayout.DOWN)),
            "parts": tuple(_part(entry) for entry in data["parts"]),
            "joints": tuple(_joint(entry) for entry in data["joints"]),
            "grip_sensors": tuple(_grip_sensor(entry) for entry in data.get("grip_sensors", [])),
        }
    )


def _one_of(kind: type[Kind], name: str, value: str) -> Kind:
    try:
        return kind(value)
    except ValueError:
        raise ValueError(f"{name} {value!r} must be one of {', '.join(kind)}") from None


def _part(entry: dict[str, Any]) -> Part:
    what = f"part {entry.get('name')!r}"
    values = {("shape" if key == "vertices" else key): value for key, value in entry.items()}
    _check_fields(what, values, Part, {"shape": "vertices"})
    critical = entry.get("critical", [])
    if not (isinstance(critical, list) and all(isinstance(name, str) for name in critical)):
        raise ValueError(f"{what}: critical must be a list of environments' names, got {critical!r}")
    try:
        shape = Polygon(tuple((float(x), float(y)) for x, y in entry["vertices"]))
    except ValueError as error:
        raise ValueError(f"{what}: {error}") from error
    return Part(
        **{**values, "shape": shape, "position": tuple(entry["position"]), "critical": tuple(critical)}
    )


def _joint(entry: dict[str, Any]) -> Joint:
    _check_fields(f"joint {entry.get('part_a')!r} to {entry.get('part_b')!r}", entry, Joint)
    points: dict[str, Any] = {
        key: tuple(entry[key]) for key in ("anchor", "anchor_b", "limits") if key in entry
    }
    return Joint(**(entry | points))


def _grip_sensor(entry: dict[str, Any]) -> GripSensor:
    _check_fields(f"grip sensor {entry.get('name')!r}", entry, GripSensor)
    return GripSensor(**{**entry, "position": tuple(entry["position"])})


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
        raise ValueError(f"{what}: unknown field {name!r}; known: {', '.join(known.values())}")
    for name in sorted(required - entry.keys()):
        raise ValueError(f"{what}: field {known[name]!r} is missing")
