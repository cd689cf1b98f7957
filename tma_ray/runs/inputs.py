"""Plug-ins and input files of runs, captured when a run is planned and provided where it is executed.

An option that names a file, such as an embodiment in a ``.toml`` or ``cppn_weights``, identifies it by its
content and its name without the folder: an edited file changes the run id, a moved one does not.
"""

import hashlib
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from uuid import uuid4

import gymnasium

from tma_ray.components.plugin_source import PluginSource
from tma_ray.components.registry import Registry
from tma_ray.envs import ENVIRONMENTS, make_environment
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
"""Registries of the components of a run that may be plug-ins."""

_importing = ContextVar("importing plug-ins", default=False)


def plugins_of(names: Mapping[str, str]) -> dict[str, Plugin]:
    """Return the plug-ins among the `names` of a run's components.

    Raises:
        UnknownNameError: if a name is unknown.
        ValueError: if a plug-in could not be imported by other processes.
    """
    sources = {part: registry.plugin(names[part]) for part, registry in REGISTRIES.items()}
    return {part: Plugin(source.module, source.digest) for part, source in sources.items() if source}


def algorithm_versions_of(names: Mapping[str, str]) -> dict[str, int]:
    """Return the algorithm versions that a run's components declare.

    Raises:
        UnknownNameError: if a name is unknown.
        ValueError: if a declared version is not a whole number.
    """
    versions = {part: registry.algorithm_version(names[part]) for part, registry in REGISTRIES.items()}
    return {part: version for part, version in versions.items() if version is not None}


def import_plugins(spec: RunSpec, *parts: str) -> None:
    """Import and register the plug-ins among the components `parts` of a run.

    Raises:
        ValueError: if the source of a plug-in differs from the planned one.
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
                actual = "one that ships with tma_ray" if source is None else f"version {source.digest}"
                installed = source is not None and source.installed
                remedy = "install the same version everywhere" if installed else "start it again"
                raise ValueError(
                    f"{part} {name!r}: this machine has {actual}, which is not what the run was planned "
                    f"with; its source differs or was edited since: {remedy}"
                )


def importing_plugins() -> bool:
    """Return True while a module is being imported for its plug-in."""
    return _importing.get()


MAX_INPUT_BYTES = 20 * 2**20  # size limit of input files, which every process of a run holds in memory

OPTION_FIELDS = {
    "environment": "environment_options",
    "student": "student_hyperparameters",
    "teacher": "teacher_hyperparameters",
}
"""Fields of a spec that hold the options of each component."""

_contents: dict[str, bytes] = {}  # contents of input files in memory, by SHA-256


def captured(part: str, options: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, InputFile]]:
    """Read the files named in a component's options, and return the adjusted options and the files.

    File names replace the paths in the options; the contents of the files are kept in memory.

    Args:
        part: "environment", "student" or "teacher".
        options: options by name. A string names a file if it is an existing path with a suffix or a folder,
            optionally followed by settings.

    Returns:
        The options with file names instead of paths, and the files by component and option.

    Raises:
        ValueError: if a file is too large.
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
        if size > MAX_INPUT_BYTES:
            raise ValueError(
                f"{path} has {size / 2**20:.0f} MiB: an input of a run may have "
                f"{MAX_INPUT_BYTES / 2**20:.0f} MiB, as every process of the run holds it; let a plug-in "
                f"read larger data"
            )
        data = path.read_bytes()
        file = InputFile(path.name, hashlib.sha256(data).hexdigest())
        _contents[file.sha256] = data
        shown[option] = file.name + str(value)[len(name) :]
        files[f"{part}.{option}"] = file
    return shown, files


def named(part: str, name: str) -> str:
    """Return the canonical name of a component, with file names instead of paths."""
    base, settings = split_name(name)
    return join_name(base, captured(part, settings)[0])


def arguments(spec: RunSpec, part: str) -> dict[str, Any]:
    """Return the options of a run's component, with the paths of its input files in this process.

    Raises:
        ValueError: if the content of a file is not known in this process.
    """
    values = dict(getattr(spec, OPTION_FIELDS[part]))
    for option, value in values.items():
        file = spec.inputs.get(f"{part}.{option}")
        if file is not None:
            values[option] = f"{_provided(file)}{str(value)[len(base_name(str(value))) :]}"
    return values


def new_environment(spec: RunSpec) -> gymnasium.Env[Any, Any]:
    """Return a new environment for a run whose plug-ins are registered in this process."""
    return make_environment(spec.environment, **arguments(spec, "environment"))


def contents(specs: Iterable[RunSpec]) -> dict[str, bytes]:
    """Return the contents of the input files of `specs` that are in memory, by SHA-256."""
    digests = {file.sha256 for spec in specs for file in spec.inputs.values()}
    return {sha256: _contents[sha256] for sha256 in sorted(digests) if sha256 in _contents}


def provide(contents_by_digest: Mapping[str, bytes]) -> None:
    """Keep in memory the input files of another process, given as contents by SHA-256."""
    _contents.update(contents_by_digest)


@dataclass(frozen=True)
class RunInputs:
    """Inputs of runs from outside this package: plug-in sources and input files.

    Attributes:
        sources: sources of the plug-ins.
        files: contents of the input files held by this process, by SHA-256.
    """

    sources: tuple[PluginSource, ...]
    files: Mapping[str, bytes]

    @classmethod
    def of(cls, specs: Sequence[RunSpec]) -> "RunInputs":
        """Return the inputs of `specs`, without duplicates."""
        names = sorted({(part, getattr(spec, part)) for spec in specs for part in spec.plugins})
        sources = (REGISTRIES[part].plugin(name) for part, name in names)
        return cls(tuple(filter(None, sources)), contents(specs))

    def keep(self, store: Store) -> None:
        """Write the plug-in sources and input files into a results root."""
        for data in self.files.values():
            store_input(store, data)
        for source in self.sources:
            store_plugin(store, source)


def fetch(store: Store, spec: RunSpec) -> None:
    """Read the input files of a run from a results root into memory.

    Raises:
        DamagedFileError: if a file is damaged.
    """
    for file in spec.inputs.values():
        if file.sha256 not in _contents:
            try:
                _contents[file.sha256] = read_input(store, file.sha256)
            except FileNotFoundError:
                continue  # `arguments` raises an error if the file is needed


def fetch_beside(folder: Path, spec: RunSpec) -> None:
    """Read the input files of a run into memory from a folder, such as an export, by their names.

    Raises:
        DamagedFileError: if a file has other content.
    """
    for file in spec.inputs.values():
        path = folder / file.name
        if file.sha256 not in _contents and path.is_file():
            data = read_file(path, MAX_INPUT_BYTES)
            if hashlib.sha256(data).hexdigest() != file.sha256:
                raise DamagedFileError(f"{path} is not the file that run {spec.run_id} was trained with")
            _contents[file.sha256] = data


def write_inputs(spec: RunSpec, folder: Path) -> None:
    """Write the input files of a run into an existing folder, by name.

    Raises:
        ValueError: if the content of a file is not known in this process.
    """
    for file in spec.inputs.values():
        (folder / file.name).write_bytes(_provided(file).read_bytes())


def _provided(file: InputFile) -> Path:
    """Return the path of an input file in this process's temporary folder."""
    path = Path(_folder().name) / file.sha256 / file.name
    if not path.exists():
        if file.sha256 not in _contents:
            raise ValueError(
                f"the content of {file.name} (sha256 {file.sha256[:12]}…) is not here: open the run from its "
                f"results root or release, or lay the file beside the policy"
            )
        path.parent.mkdir(exist_ok=True)
        temporary = path.with_name(f"{uuid4().hex}-{file.name}")
        temporary.write_bytes(_contents[file.sha256])
        temporary.replace(path)  # atomic, since other threads may open the file
    return path


@cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="tma_ray_inputs_")
