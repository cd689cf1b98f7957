"""Sections of a body's file that are written out several times, such as pairs of legs."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import msgspec

Entry = dict[str, Any]

PLACES = ("position", "anchor", "anchor_b")
"""Fields that move with a copy."""

LAST = "last"
"""Value of `head`: true in the last copy only."""

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
        joints: entries of joints, likewise.
        links: entries of joints between copies k and k + 1.
        grip_sensors: entries of grip sensors, likewise.
        step: how far apart the copies are, in m. They stand around the place written down.
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
        """Checks a number of copies; 3.0 is as whole as 3.

        Raises:
            ValueError: it is not a whole number from 1 to `at_most`.
        """
        is_number = isinstance(count, int | float) and not isinstance(count, bool)
        if not is_number or count not in range(1, self.at_most + 1):
            raise ValueError(f"{self.parameter} {count!r} must be a whole number from 1 to {self.at_most}")


def repeats(data: Mapping[str, Any]) -> dict[str, Repeat]:
    """Returns the sections of a body's file, by parameter.

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
    """Returns a body's file with its sections written out after the entries outside them.

    Args:
        data: the file's contents.
        counts: copies of each section, by parameter.
    """
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
    """Returns copy `number` of `count`."""
    copy = {key: _numbered(value, number) for key, value in entry.items()}
    shift = number - 1 - (count - 1) / 2
    for key in PLACES & copy.keys():
        copy[key] = [place + shift * step for place, step in zip(copy[key], section.step, strict=True)]
    if copy.get("head") == LAST:
        copy["head"] = number == count
    return copy


def _numbered(value: Any, number: int) -> Any:
    if not isinstance(value, str):
        return value
    return NUMBER.sub(lambda match: str(int(match[1] or 1) * number + int(match[2] or 0)), value)
