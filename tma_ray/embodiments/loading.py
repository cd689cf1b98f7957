"""Reads bodies from their data files."""

from __future__ import annotations

import difflib
import tomllib
from dataclasses import MISSING, fields
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from tma_ray.embodiments.embodiment import BodyType, Embodiment, EmbodimentError, Joint, Part
from tma_ray.embodiments.polygon import Polygon


def embodiment_names() -> list[str]:
    """Returns the names of the bodies shipped with tma_ray, sorted."""
    return sorted(
        path.name.removesuffix(".toml") for path in _folder().iterdir() if path.name.endswith(".toml")
    )


def load_embodiment(name_or_path: str | Path) -> Embodiment:
    """Returns a body by name, or from a TOML file laid out as those in `tma_ray/embodiments/data`.

    Raises:
        EmbodimentError: unknown name, unreadable file, or a body that cannot be built.
    """
    if str(name_or_path).endswith(".toml"):
        return _parse(Path(name_or_path))
    if name_or_path not in embodiment_names():
        near = difflib.get_close_matches(str(name_or_path), embodiment_names(), n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise EmbodimentError(
            f"unknown embodiment {str(name_or_path)!r}: {hint}"
            f"known: {', '.join(embodiment_names())}, or the path of a .toml file"
        )
    return _shipped(str(name_or_path))


@cache
def _shipped(name: str) -> Embodiment:
    return _parse(_folder() / f"{name}.toml")


def _folder() -> Traversable:
    return resources.files("tma_ray.embodiments") / "data"


def _parse(path: Traversable) -> Embodiment:
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
        return _embodiment(data)
    except EmbodimentError:
        raise
    except (OSError, tomllib.TOMLDecodeError, TypeError, ValueError) as error:
        raise EmbodimentError(f"{path}: {error}") from error


def _embodiment(data: dict[str, Any]) -> Embodiment:
    _check_fields("body", data, Embodiment)
    return Embodiment(
        **{
            **data,
            "body_type": BodyType(data["body_type"]),
            "parts": tuple(_part(entry) for entry in data["parts"]),
            "joints": tuple(_joint(entry) for entry in data["joints"]),
        }
    )


def _part(entry: dict[str, Any]) -> Part:
    what = f"part {entry.get('name')!r}"
    values = {("shape" if key == "vertices" else key): value for key, value in entry.items()}
    _check_fields(what, values, Part, {"shape": "vertices"})
    try:
        shape = Polygon(tuple((float(x), float(y)) for x, y in entry["vertices"]))
    except ValueError as error:
        raise ValueError(f"{what}: {error}") from error
    return Part(**{**values, "shape": shape, "position": tuple(entry["position"])})


def _joint(entry: dict[str, Any]) -> Joint:
    _check_fields(f"joint {entry.get('part_a')!r} to {entry.get('part_b')!r}", entry, Joint)
    return Joint(**{**entry, "anchor": tuple(entry["anchor"]), "limits": tuple(entry["limits"])})


def _check_fields(
    what: str,
    entry: dict[str, Any],
    kind: type[Embodiment | Part | Joint],
    renamed: dict[str, str] | None = None,
) -> None:
    names = renamed or {}
    known = {field.name: names.get(field.name, field.name) for field in fields(kind)}
    required = {field.name for field in fields(kind) if field.default is MISSING}
    for name in sorted(entry.keys() - known.keys()):
        raise ValueError(f"{what}: unknown field {name!r}; known: {', '.join(known.values())}")
    for name in sorted(required - entry.keys()):
        raise ValueError(f"{what}: field {known[name]!r} is missing")
