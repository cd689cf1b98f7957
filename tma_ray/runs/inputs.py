"""The files that runs read: captured by content when a run is planned, provided wherever it is executed.

An option that names a file, such as an embodiment in a ``.toml`` or ``cppn_weights``, is a part of a run by
the file's content and its name without the folder: an edited file makes another run, a moved one the same.
"""

import hashlib
import tempfile
from collections.abc import Iterable, Mapping
from contextvars import ContextVar
from functools import cache
from pathlib import Path
from typing import Any
from uuid import uuid4

from tma_ray.components.plugin_source import PluginSource
from tma_ray.components.registry import Registry
from tma_ray.envs import ENVIRONMENTS
from tma_ray.results import Store, read_input, store_input, store_plugin
from tma_ray.runs.spec import InputFile, Plugin, RunSpec
from tma_ray.students import STUDENTS
from tma_ray.support.component_names import base_name, join_name, split_name
from tma_ray.support.decoding import DamagedFileError, read_file
from tma_ray.support.quantities import expanded
from tma_ray.teachers import TEACHERS

REGISTRIES: Mapping[str, Registry[Any]] = {
    "environment": ENVIRONMENTS,
    "student": STUDENTS,
    "teacher": TEACHERS,
}
"""The parts of a cell and of a run that may be plug-ins."""

_importing = ContextVar("importing plug-ins", default=False)


def plugins_of(names: Mapping[str, str]) -> dict[str, Plugin]:
    """Return the plug-ins among the `names` of a run's parts.

    Raises:
        UnknownNameError: nothing answers to a name.
        ValueError: a plug-in that no other process could import.
    """
    sources = {part: registry.plugin(names[part]) for part, registry in REGISTRIES.items()}
    return {part: Plugin(source.module, source.digest) for part, source in sources.items() if source}


def algorithm_versions_of(names: Mapping[str, str]) -> dict[str, int]:
    """Return the algorithm versions that a run's parts, by their `names`, declare.

    Raises:
        UnknownNameError: nothing answers to a name.
        ValueError: a part that declares something else than a whole number.
    """
    versions = {part: registry.algorithm_version(names[part]) for part, registry in REGISTRIES.items()}
    return {part: version for part, version in versions.items() if version is not None}


def plugin_sources(specs: Iterable[RunSpec]) -> list[PluginSource]:
    """Return the source of every plug-in of `specs`, each once."""
    names = {(part, getattr(spec, part)) for spec in specs for part in spec.plugins}
    found = (REGISTRIES[part].plugin(name) for part, name in sorted(names))
    return [source for source in found if source is not None]


def import_plugins(spec: RunSpec, *parts: str) -> None:
    """Make the plug-ins among `parts` of a run known in this process.

    Raises:
        ValueError: an input of that name differs here from that of the plan.
    """
    for part in parts:
        if part in spec.plugins:
            name, plugin = getattr(spec, part), spec.plugins[part]
            token = _importing.set(True)
            try:
                REGISTRIES[part].learn(name, plugin.module)
                source = REGISTRIES[part].plugin(name)
            finally:
                _importing.reset(token)
            if source is None or source.digest != plugin.digest:
                found = "one that ships with tma_ray" if source is None else f"version {source.digest}"
                installed = source is not None and source.installed
                remedy = "install the same version everywhere" if installed else "start it again"
                raise ValueError(
                    f"{part} {name!r}: this machine has {found}, which is not what the run was planned with; "
                    f"its source differs or was edited since: {remedy}"
                )


def importing_plugins() -> bool:
    """Return True while a module is imported for its plug-in."""
    return _importing.get()


MOST_BYTES = 20 * 2**20  # size over which an input is refused: every run's process holds it

VALUES = {
    "environment": "environment_options",
    "student": "student_hyperparameters",
    "teacher": "teacher_hyperparameters",
}
"""Fields of a spec that hold the options of each part."""

_contents: dict[str, bytes] = {}  # contents that this process has read or received, by SHA-256


def captured(part: str, options: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, InputFile]]:
    """Read the files that options name.

    Args:
        part: "environment", "student" or "teacher".
        options: options by name. A text that is the path of a file, with parameters of a body after it if
            wanted, names that file if it has a suffix or a folder: names of what ships have neither.

    Returns:
        The options with the file's name in place of its path, and the files by part and option.

    Raises:
        ValueError: a file that is too large.
    """
    shown, files = dict(options), {}
    for option, value in options.items():
        if not isinstance(value, (str, Path)):
            continue
        name = base_name(str(value))
        path = expanded(name)
        if not (path.suffix or len(path.parts) > 1) or not path.is_file():
            continue
        size = path.stat().st_size
        if size > MOST_BYTES:
            raise ValueError(
                f"{path} has {size / 2**20:.0f} MiB: an input of a run may have {MOST_BYTES / 2**20:.0f} "
                f"MiB, as every process of the run holds it; let a plug-in read larger data"
            )
        data = path.read_bytes()
        file = InputFile(path.name, hashlib.sha256(data).hexdigest())
        _contents[file.sha256] = data
        shown[option] = file.name + str(value)[len(name) :]
        files[f"{part}.{option}"] = file
    return shown, files


def named(part: str, name: str) -> str:
    """Return the canonical name of a part with names of files in place of their paths."""
    base, settings = split_name(name)
    return join_name(base, captured(part, settings)[0])


def arguments(spec: RunSpec, part: str) -> dict[str, Any]:
    """Return the options of a part of a run, with paths of its files in this process.

    Raises:
        ValueError: the content of a file is not known here.
    """
    values = dict(getattr(spec, VALUES[part]))
    for option, value in values.items():
        file = spec.inputs.get(f"{part}.{option}")
        if file is not None:
            values[option] = f"{_provided(file)}{str(value)[len(base_name(str(value))) :]}"
    return values


def contents(specs: Iterable[RunSpec]) -> dict[str, bytes]:
    """Return the content of all inputs of `specs` that this process knows, by SHA-256."""
    wanted = {file.sha256 for spec in specs for file in spec.inputs.values()}
    return {sha256: _contents[sha256] for sha256 in sorted(wanted) if sha256 in _contents}


def provide(known: Mapping[str, bytes]) -> None:
    """Make the contents of another process, by SHA-256, known in this one."""
    _contents.update(known)


def keep(store: Store, specs: Iterable[RunSpec]) -> None:
    """Write the inputs of `specs` and the sources of their plug-ins into a results root."""
    planned = list(specs)
    for data in contents(planned).values():
        store_input(store, data)
    for source in plugin_sources(planned):
        store_plugin(store, source)


def fetch(store: Store, spec: RunSpec) -> None:
    """Make the inputs of a run known in this process, as far as the root keeps them.

    Raises:
        DamagedFileError: one is not what was written.
    """
    for file in spec.inputs.values():
        if file.sha256 not in _contents:
            try:
                _contents[file.sha256] = read_input(store, file.sha256)
            except FileNotFoundError:
                continue  # named when it is needed


def fetch_beside(folder: Path, spec: RunSpec) -> None:
    """Make a run's inputs in a folder known, which have their own names there, as in exports.

    Raises:
        DamagedFileError: one of them has another content.
    """
    for file in spec.inputs.values():
        path = folder / file.name
        if file.sha256 not in _contents and path.is_file():
            data = read_file(path, MOST_BYTES)
            if hashlib.sha256(data).hexdigest() != file.sha256:
                raise DamagedFileError(f"{path} is not the file that run {spec.run_id} was trained with")
            _contents[file.sha256] = data


def write_inputs(spec: RunSpec, folder: Path) -> None:
    """Write the inputs of a run into an existing folder, under their own names.

    Raises:
        ValueError: the content of one is not known here.
    """
    for file in spec.inputs.values():
        (folder / file.name).write_bytes(_provided(file).read_bytes())


def _provided(file: InputFile) -> Path:
    """Return the path of a file with this content and name, in a folder of this process."""
    path = Path(_folder().name) / file.sha256 / file.name
    if not path.exists():
        if file.sha256 not in _contents:
            raise ValueError(
                f"the content of {file.name} (sha256 {file.sha256[:12]}…) is not here: open the run from its "
                f"results root or release, or lay the file beside the policy"
            )
        path.parent.mkdir(exist_ok=True)
        aside = path.with_name(f"{uuid4().hex}-{file.name}")
        aside.write_bytes(_contents[file.sha256])
        aside.replace(path)  # at once: other threads may look for it
    return path


@cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="tma_ray_inputs_")
