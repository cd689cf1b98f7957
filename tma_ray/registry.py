"""Names to implementations: built-in, decorated, installed as entry points, or given as ``module:Name``.

A new teacher, student or environment needs no edit of this package: its author decorates it,
declares an entry point, or passes ``my_module:MyTeacher`` wherever a name is expected.
"""

from __future__ import annotations

import difflib
import hashlib
import importlib
import inspect
from collections.abc import Callable, Mapping
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

T = TypeVar("T")
C = TypeVar("C")


class UnknownNameError(ValueError):
    """A name that no registry entry answers to; the message holds the nearest match."""


class Registry(Generic[T]):
    """The implementations of one kind of part, imported only when asked for.

    Args:
        kind: what the names stand for ("teacher"), used in messages.
        entry_point_group: group under which installed packages may offer more.
        builtin: names shipped with tma_ray, each a ``module:Name`` target.
    """

    def __init__(self, kind: str, entry_point_group: str, builtin: Mapping[str, str]) -> None:
        self.kind = kind
        self.entry_point_group = entry_point_group
        self._targets = dict(builtin)
        self._decorated: dict[str, T] = {}

    def register(self, name: str) -> Callable[[C], C]:
        """Returns a decorator that makes an implementation known under `name`.

        Raises:
            ValueError: another implementation already has that name.
        """

        def decorate(implementation: C) -> C:
            known = self._decorated.get(name)
            if known is not None and _identity(known) != _identity(implementation):
                raise ValueError(f"{self.kind} {name!r} is already {_identity(known)}; choose another name")
            self._decorated[name] = cast("T", implementation)
            return implementation

        return decorate

    def names(self) -> list[str]:
        """Returns all known names, sorted."""
        return sorted({*self._targets, *self._decorated, *self._installed()})

    def get(self, name: str) -> T:
        """Returns the implementation called `name`.

        Args:
            name: a registered name, or ``module:Name`` for one that is not registered.

        Raises:
            UnknownNameError: nothing answers to `name`, or its module has no such attribute.
        """
        if name in self._decorated:
            return self._decorated[name]
        target = self._targets.get(name) or self._installed().get(name)
        if target is None and ":" in name:
            target = name
        if target is None:
            raise UnknownNameError(self._explain(name))
        return self._load(target)

    def plugin_digest(self, name: str) -> str | None:
        """Returns a hash of the source file of a plug-in, so that an edited one is never taken for the old.

        Returns None for what ships with tma_ray, whose version is part of every run already; that is
        not even imported.

        Raises:
            UnknownNameError: nothing answers to `name`.
        """
        target = self._targets.get(name, name)
        if name not in self._decorated and target.split(".")[0] == __package__:
            return None
        implementation: Any = self.get(name)
        if implementation.__module__.split(".")[0] == __package__:
            return None
        source = inspect.getsourcefile(implementation)
        assert source is not None, f"{implementation} has no source file"
        return hashlib.sha256(Path(source).read_bytes()).hexdigest()[:16]

    def _installed(self) -> dict[str, str]:
        return {point.name: point.value for point in entry_points(group=self.entry_point_group)}

    def _load(self, target: str) -> T:
        module_name, _, attribute = target.partition(":")
        try:
            return cast("T", getattr(importlib.import_module(module_name), attribute))
        except ModuleNotFoundError as error:
            if error.name is None or not module_name.startswith(error.name):
                raise  # the module exists; something that it imports does not
            raise UnknownNameError(
                f"{self.kind} {target!r}: no module {module_name!r} on the import path; "
                f"run from its folder or install it"
            ) from error
        except AttributeError as error:
            raise UnknownNameError(
                f"{self.kind} {target!r}: module {module_name!r} has no {attribute!r}"
            ) from error

    def _explain(self, name: str) -> str:
        by_lower_case = {known.lower(): known for known in self.names()}
        near = difflib.get_close_matches(name.lower(), by_lower_case, n=1)
        hint = f"did you mean {by_lower_case[near[0]]!r}? " if near else ""
        return f"unknown {self.kind} {name!r}: {hint}known: {', '.join(self.names())}, or module:Name"


def _identity(implementation: object) -> str:
    module = getattr(implementation, "__module__", "?")
    return f"{module}.{getattr(implementation, '__qualname__', implementation)}"
