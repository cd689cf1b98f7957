"""The parts of a run that do not ship with tma_ray: told apart by their source, imported where they run."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

from tma_ray.envs import ENVIRONMENTS
from tma_ray.plugin_source import PluginSource
from tma_ray.registry import Registry
from tma_ray.runs.spec import Plugin, RunSpec
from tma_ray.students import STUDENTS
from tma_ray.teachers import TEACHERS

REGISTRIES: Mapping[str, Registry[Any]] = {
    "environment": ENVIRONMENTS,
    "student": STUDENTS,
    "teacher": TEACHERS,
}
"""The parts of a cell and of a run that may be plug-ins."""

_importing = ContextVar("importing plug-ins", default=False)


def plugins_of(names: Mapping[str, str]) -> dict[str, Plugin]:
    """Returns the plug-ins among the `names` of a run's parts.

    Raises:
        UnknownNameError: nothing answers to a name.
        ValueError: a plug-in that no other process could import.
    """
    sources = {part: registry.plugin(names[part]) for part, registry in REGISTRIES.items()}
    return {part: Plugin(source.module, source.digest) for part, source in sources.items() if source}


def algorithm_versions_of(names: Mapping[str, str]) -> dict[str, int]:
    """Returns the algorithm versions that a run's parts, by their `names`, declare.

    Raises:
        UnknownNameError: nothing answers to a name.
        ValueError: a part that declares something else than a whole number.
    """
    versions = {part: registry.algorithm_version(names[part]) for part, registry in REGISTRIES.items()}
    return {part: version for part, version in versions.items() if version is not None}


def plugin_sources(specs: Iterable[RunSpec]) -> list[PluginSource]:
    """Returns the source of every plug-in of `specs`, each once."""
    names = {(part, getattr(spec, part)) for spec in specs for part in spec.plugins}
    found = (REGISTRIES[part].plugin(name) for part, name in sorted(names))
    return [source for source in found if source is not None]


def import_plugins(spec: RunSpec, *parts: str) -> None:
    """Makes the plug-ins among `parts` of a run known in this process.

    Raises:
        ValueError: what is found here under that name is not what the run was planned with.
    """
    for part in parts:
        if part in spec.plugins:
            name, plugin = getattr(spec, part), spec.plugins[part]
            with _import_in_progress():
                REGISTRIES[part].learn(name, plugin.module)
                source = REGISTRIES[part].plugin(name)
            if source is None or source.digest != plugin.digest:
                raise ValueError(_other_version(part, name, source))


def importing_plugins() -> bool:
    """Tells whether the code that asks is being imported because it holds a plug-in."""
    return _importing.get()


@contextmanager
def _import_in_progress() -> Iterator[None]:
    token = _importing.set(True)
    try:
        yield
    finally:
        _importing.reset(token)


def _other_version(part: str, name: str, source: PluginSource | None) -> str:
    found = "one that ships with tma_ray" if source is None else f"version {source.digest}"
    remedy = "install the same version everywhere" if source and source.installed else "start it again"
    return (
        f"{part} {name!r}: this machine has {found}, which is not what the run was planned with; "
        f"its source differs or was edited since: {remedy}"
    )
