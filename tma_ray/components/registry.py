"""Registries of implementations: built-in, decorated, from entry points, or given as ``module:Name``.

Plug-ins need no edit of this package: decorate a class, declare an entry point, or pass
``my_module:MyTeacher`` wherever a name is expected.
"""

import contextlib
import importlib
import re
import sys
from collections.abc import Callable, Mapping
from functools import cache
from importlib.metadata import EntryPoints, entry_points
from pathlib import Path
from types import ModuleType
from typing import Final, Generic, TypeVar, cast

from tma_ray.components.plugin_source import OURS, PluginSource, importable_name
from tma_ray.support.component_names import base_name, nearest
from tma_ray.support.lazy_imports import docstring_of

ComponentT = TypeVar("ComponentT")
C = TypeVar("C")


class UnknownNameError(ValueError):
    """Error for an unknown name; the message suggests the nearest match."""


class PluginImportError(ValueError):
    """Error raised if the import of a user's module fails."""


_NAME: Final = re.compile(r"[\w.-]+")

_searched: list[str] = []  # folders searched for ``module:Name`` after the import path


def search_current_folder() -> None:
    """Make ``module:Name`` look up modules in the current folder, too, after the import path."""
    _searched[:] = [str(Path.cwd())]


class Registry(Generic[ComponentT]):
    """Registry of the implementations of one kind of component, imported on first use.

    Args:
        kind: kind of component in messages ("teacher").
        entry_point_group: group of entry points of installed packages.
        builtin: ``module:Name`` of built-in implementations by name.
        base: base class of all implementations, or its ``module:Name``.
    """

    def __init__(
        self, kind: str, entry_point_group: str, builtin: Mapping[str, str], base: type | str = object
    ) -> None:
        self.kind = kind
        self._base = base
        self.entry_point_group = entry_point_group
        self._targets = dict(builtin)
        self._decorated: dict[str, ComponentT] = {}
        self._origins: dict[str, str] = {}
        self._sources: dict[tuple[str, ComponentT], PluginSource] = {}

    @property
    def base(self) -> type:
        """Base class of all implementations."""
        if isinstance(self._base, str):
            module, _, name = self._base.partition(":")
            base: type = getattr(importlib.import_module(module), name)
            self._base = base
        return self._base

    def register(self, name: str) -> Callable[[C], C]:
        """Return a decorator that registers an implementation under `name`.

        Raises:
            ValueError: if the name is invalid or taken.
            TypeError: if the implementation does not inherit from `base`.
        """
        if not _NAME.fullmatch(name):
            raise ValueError(f"{self.kind} {name!r}: expected a name of letters, digits, '_', '-' and '.'")

        def decorate(implementation: C) -> C:
            if not self._fits(implementation):
                raise TypeError(f"{self.kind} {name!r} is {implementation!r:.80}: {self._expected}")
            if self._targets.get(name, _target_of(implementation)) != _target_of(implementation):
                raise ValueError(f"{self.kind} {name!r} ships with tma_ray; choose another name")
            existing = self._decorated.get(name)
            if existing is not None and _identity(existing) != _identity(implementation):
                raise ValueError(
                    f"{self.kind} {name!r} is already {_identity(existing)}; choose another name"
                )
            self._decorated[name] = cast("ComponentT", implementation)
            self._origins[name] = sys._getframe(1).f_globals["__name__"]
            return implementation

        return decorate

    def names(self) -> list[str]:
        """Return all names, sorted."""
        return sorted({*self._targets, *self._decorated, *self._installed()})

    def summaries(self) -> dict[str, str]:
        """Return the first lines of the implementations' docstrings by name; "" without a docstring."""
        return {name: self._summary(name) for name in self.names()}

    def _summary(self, name: str) -> str:
        """Return the first docstring line, read from the source if possible, since imports take seconds."""
        text = None if name in self._decorated else docstring_of(*self._target(name).split(":"))
        return ((self.get(name).__doc__ if text is None else text) or "").strip().partition("\n")[0]

    def get(self, name: str) -> ComponentT:
        """Return the implementation of a registered name or ``module:Name``, ignoring settings in the name.

        Raises:
            UnknownNameError: if `name` is unknown, or its module has no such attribute.
        """
        name = base_name(name)
        if name in self._decorated:
            return self._decorated[name]
        return self._load(self._target(name))

    def origin(self, name: str) -> str | None:
        """Return the module whose import registers `name`, or None for built-in names.

        Raises:
            UnknownNameError: if `name` is unknown.
        """
        name = base_name(name)
        module = self._origins.get(name) or self._target(name).partition(":")[0]
        return None if module.partition(".")[0] == OURS else module

    def plugin(self, name: str) -> PluginSource | None:
        """Return a plug-in's source at its first lookup, or None for built-in implementations.

        The source includes files that match patterns in the plug-in's attribute `data_files`, relative to
        its module.

        Raises:
            UnknownNameError: if `name` is unknown.
            ValueError: if other processes cannot import it.
        """
        module = self.origin(name)
        if module is None:
            return None
        implementation = self.get(name)
        key = module, implementation
        if key not in self._sources:  # cached, since later edits do not change the imported code
            try:
                self._sources[key] = PluginSource.of(module, getattr(implementation, "data_files", ()))
            except ValueError as error:
                raise ValueError(f"{self.kind} {name!r}: {error}") from error
        return self._sources[key]

    def algorithm_version(self, name: str) -> int | None:
        """Return the `algorithm_version` of an implementation, or None if it declares none.

        Built-in implementations raise it with every change of behaviour. Plug-ins need none, since they are
        identified by the hash of their source.

        Raises:
            UnknownNameError: if `name` is unknown.
            ValueError: if it is not a whole number of at least 1.
        """
        return self._checked_version(name, getattr(self.get(name), "algorithm_version", None))

    def _checked_version(self, name: str, version: object) -> int | None:
        if version is None:
            return None
        if not isinstance(version, int) or isinstance(version, bool) or version < 1:
            raise ValueError(
                f"{self.kind} {name!r} has algorithm_version = {version!r}; expected a whole number from 1"
            )
        return version

    def learn(self, name: str, module: str) -> None:
        """Import `module` to register `name`, unless the name is already registered."""
        name = base_name(name)
        if ":" not in name and name not in self.names():
            self._import(name, module)

    def _target(self, name: str) -> str:
        target = self._targets.get(name) or self._installed().get(name)
        if target is None and ":" in name:
            target = name
        if target is None:
            raise UnknownNameError(self._explain(name))
        return target

    def _installed(self) -> Mapping[str, str]:
        points = _entry_points(tuple(sys.path)).select(group=self.entry_point_group)
        return {point.name: point.value for point in points}

    def _load(self, target: str) -> ComponentT:
        module_name, _, attribute = target.partition(":")
        if not all(part.isidentifier() for part in (*module_name.split("."), attribute)):
            raise UnknownNameError(f"{self.kind} {target!r}: expected a name, or module:Name")
        module = self._import(target, module_name)
        implementation = getattr(module, attribute, None)
        if implementation is None:
            hint = nearest(attribute, [name for name, value in vars(module).items() if self._fits(value)])
            raise UnknownNameError(
                f"{self.kind} {target!r}: {hint}module {module_name!r} has no {attribute!r}"
            )
        if not self._fits(implementation):
            raise UnknownNameError(f"{self.kind} {target!r}: {self._expected}, found {implementation!r:.80}")
        return cast("ComponentT", implementation)

    @property
    def _expected(self) -> str:
        return f"expected a class that inherits from {self.base.__module__}.{self.base.__name__}"

    def _fits(self, value: object) -> bool:
        return self.base is object or (isinstance(value, type) and issubclass(value, self.base))

    def _import(self, name: str, module: str) -> ModuleType:
        """Import the module of an implementation, from the current folder if necessary."""
        sys.path.extend(folder for folder in _searched if folder not in sys.path)
        try:
            return importlib.import_module(module)
        except (Exception, SystemExit) as error:
            if isinstance(error, ModuleNotFoundError) and error.name and module.startswith(error.name):
                raise UnknownNameError(
                    f"{self.kind} {name!r}: no module {module!r} on the import path; run from its folder or "
                    f"install it"
                ) from error
            if module.partition(".")[0] == OURS:
                raise
            problem = f"raises {type(error).__name__}: {error}"
            if isinstance(error, SystemExit):
                problem = (
                    "ends the process: put what it does as a script below 'if __name__ == \"__main__\":'"
                )
            raise PluginImportError(f"{self.kind} {name!r}: importing {module!r} {problem}") from error

    def _explain(self, name: str) -> str:
        hint = nearest(name, self.names())
        return f"unknown {self.kind} {name!r}: {hint}known: {', '.join(self.names())}, or module:Name"


@cache
def _entry_points(path: tuple[str, ...]) -> EntryPoints:  # noqa: ARG001 - part of the cache key
    """Return the entry points of the packages on `path`; cached, since hundreds of files are read."""
    return cast("EntryPoints", entry_points())  # the type differs before Python 3.12


def _target_of(implementation: object) -> str:
    return f"{getattr(implementation, '__module__', '')}:{getattr(implementation, '__qualname__', '')}"


def _identity(implementation: object) -> str:
    """Return the qualified name of `implementation`, the same in a script and in processes that import it."""
    module = getattr(implementation, "__module__", "?")
    with contextlib.suppress(ValueError):  # raised in interactive sessions
        module = importable_name(module)
    return f"{module}.{getattr(implementation, '__qualname__', implementation)}"
