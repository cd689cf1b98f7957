"""Names to implementations: built-in, decorated, installed as entry points, or given as ``module:Name``.

A new teacher, student or environment needs no edit of this package: its author decorates it,
declares an entry point, or passes ``my_module:MyTeacher`` wherever a name is expected.
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
from tma_ray.support.docstrings import docstring_of

T = TypeVar("T")
C = TypeVar("C")


class UnknownNameError(ValueError):
    """A name that no registry entry answers to; the message holds the nearest match."""


class PluginImportError(ValueError):
    """A module of the user's own that raises an error when it is imported."""


_NAME: Final = re.compile(r"[\w.-]+")

_searched: list[str] = []  # folders in which ``module:Name`` is looked for, after all others


def search_current_folder() -> None:
    """Let ``module:Name`` find modules of the current folder, which shadow no others."""
    _searched[:] = [str(Path.cwd())]


class Registry(Generic[T]):
    """The implementations of one kind of part, imported only when asked for.

    Args:
        kind: kind of thing that the names are for ("teacher"), used in messages.
        entry_point_group: group under which installed packages may offer more.
        builtin: names shipped with tma_ray, each a ``module:Name`` target.
        base: class that all implementations inherit from, or its ``module:Name``, imported when needed.
    """

    def __init__(
        self, kind: str, entry_point_group: str, builtin: Mapping[str, str], base: type | str = object
    ) -> None:
        self.kind = kind
        self._base = base
        self.entry_point_group = entry_point_group
        self._targets = dict(builtin)
        self._decorated: dict[str, T] = {}
        self._origins: dict[str, str] = {}
        self._sources: dict[tuple[str, T], PluginSource] = {}

    @property
    def base(self) -> type:
        """The class that all implementations inherit from."""
        if isinstance(self._base, str):
            module, _, name = self._base.partition(":")
            found: type = getattr(importlib.import_module(module), name)
            self._base = found
        return self._base

    def register(self, name: str) -> Callable[[C], C]:
        """Return a decorator that makes an implementation known under `name`.

        Raises:
            ValueError: another implementation already has that name, or it is none.
            TypeError: the implementation does not inherit from `base`.
        """
        if not _NAME.fullmatch(name):
            raise ValueError(f"{self.kind} {name!r}: expected a name of letters, digits, '_', '-' and '.'")

        def decorate(implementation: C) -> C:
            if not self._fits(implementation):
                raise TypeError(f"{self.kind} {name!r} is {implementation!r:.80}: {self._expected}")
            if self._targets.get(name, _target_of(implementation)) != _target_of(implementation):
                raise ValueError(f"{self.kind} {name!r} ships with tma_ray; choose another name")
            known = self._decorated.get(name)
            if known is not None and _identity(known) != _identity(implementation):
                raise ValueError(f"{self.kind} {name!r} is already {_identity(known)}; choose another name")
            self._decorated[name] = cast("T", implementation)
            self._origins[name] = sys._getframe(1).f_globals["__name__"]
            return implementation

        return decorate

    def names(self) -> list[str]:
        """Return all known names, sorted."""
        return sorted({*self._targets, *self._decorated, *self._installed()})

    def summaries(self) -> dict[str, str]:
        """Return the first line of the documentation of every known name; empty where there is none."""
        return {name: self._summary(name) for name in self.names()}

    def _summary(self, name: str) -> str:
        """Return the first docstring line, from the source if possible: imports may take seconds."""
        text = None if name in self._decorated else docstring_of(*self._target(name).split(":"))
        return ((self.get(name).__doc__ if text is None else text) or "").strip().partition("\n")[0]

    def get(self, name: str) -> T:
        """Return the implementation of a registered name, or ``module:Name``; settings after it are ignored.

        Raises:
            UnknownNameError: nothing answers to `name`, or its module has no such attribute.
        """
        name = base_name(name)
        if name in self._decorated:
            return self._decorated[name]
        return self._load(self._target(name))

    def origin(self, name: str) -> str | None:
        """Return the module whose import makes `name` known, None for what ships with tma_ray.

        Raises:
            UnknownNameError: nothing answers to `name`.
        """
        name = base_name(name)
        module = self._origins.get(name) or self._target(name).partition(":")[0]
        return None if module.partition(".")[0] == OURS else module

    def plugin(self, name: str) -> PluginSource | None:
        """Return the source of a plug-in, as it was when this process first asked for it.

        The name's `data_files`, if it has such an attribute, are patterns of further files that it reads,
        relative to its module's folder. None for what ships with tma_ray, which is not even imported: its
        version is part of every run already.

        Raises:
            UnknownNameError: nothing answers to `name`.
            ValueError: it is defined where no other process can import it from.
        """
        module = self.origin(name)
        if module is None:
            return None
        implementation = self.get(name)
        key = module, implementation
        if key not in self._sources:  # once: a file edited later is not what this process has imported
            try:
                self._sources[key] = PluginSource.of(module, getattr(implementation, "data_files", ()))
            except ValueError as error:
                raise ValueError(f"{self.kind} {name!r}: {error}") from error
        return self._sources[key]

    def algorithm_version(self, name: str) -> int | None:
        """Return the `algorithm_version` that an implementation declares, None if it declares none.

        What ships with tma_ray declares one, and raises it with every change of behaviour; a plug-in may,
        and is told apart by the hash of its source in any case.

        Raises:
            UnknownNameError: nothing answers to `name`.
            ValueError: it is not a whole number of at least 1.
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
        """Import `module`, whose decorator makes `name` known, unless it is known already."""
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

    def _load(self, target: str) -> T:
        module_name, _, attribute = target.partition(":")
        if not all(part.isidentifier() for part in (*module_name.split("."), attribute)):
            raise UnknownNameError(f"{self.kind} {target!r}: expected a name, or module:Name")
        module = self._import(target, module_name)
        found = getattr(module, attribute, None)
        if found is None:
            hint = nearest(attribute, [name for name, each in vars(module).items() if self._fits(each)])
            raise UnknownNameError(
                f"{self.kind} {target!r}: {hint}module {module_name!r} has no {attribute!r}"
            )
        if not self._fits(found):
            raise UnknownNameError(f"{self.kind} {target!r}: {self._expected}, found {found!r:.80}")
        return cast("T", found)

    @property
    def _expected(self) -> str:
        return f"expected a class that inherits from {self.base.__module__}.{self.base.__name__}"

    def _fits(self, found: object) -> bool:
        return self.base is object or (isinstance(found, type) and issubclass(found, self.base))

    def _import(self, name: str, module: str) -> ModuleType:
        """Import the module of an implementation; the user's own may lie in the current folder.

        Raises:
            UnknownNameError: no such module was found.
            PluginImportError: the module raises an error.
        """
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
def _entry_points(path: tuple[str, ...]) -> EntryPoints:  # noqa: ARG001 - part of the key
    """Return the entry points of the packages on `path`, read once: hundreds of files hold them."""
    return cast("EntryPoints", entry_points())  # before Python 3.12 groups, which select alike


def _target_of(implementation: object) -> str:
    return f"{getattr(implementation, '__module__', '')}:{getattr(implementation, '__qualname__', '')}"


def _identity(implementation: object) -> str:
    """Return module and name, the same for a script and for its module imported by file name."""
    module = getattr(implementation, "__module__", "?")
    with contextlib.suppress(ValueError):  # an interactive session has no other name
        module = importable_name(module)
    return f"{module}.{getattr(implementation, '__qualname__', implementation)}"
