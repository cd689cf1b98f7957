"""Packages whose parts are imported when they are first asked for: a name alone needs none of them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def import_later(
    package: str, modules: Mapping[str, str], parts: Mapping[str, str] | None = None
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return `__getattr__` and `__dir__` of a package: names by their modules, `parts` that are modules."""
    parts = parts or {}

    def get(name: str) -> Any:
        if name in parts:
            found: Any = import_module(parts[name])
        elif name in modules:
            found = getattr(import_module(modules[name]), name)
        else:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        setattr(sys.modules[package], name, found)
        return found

    def listed() -> list[str]:
        return sorted({*vars(sys.modules[package]), *modules, *parts})

    return get, listed
