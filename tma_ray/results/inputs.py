"""Storage of runs' input files and plug-in sources in the folder ``inputs``, under their hashes."""

import base64
import hashlib
import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Annotated

import msgspec

from tma_ray.components.plugin_source import PluginSource
from tma_ray.results.layout import INPUTS
from tma_ray.results.records import RunRecord
from tma_ray.results.storage import Store
from tma_ray.support.decoding import MOST_FILE_BYTES, DamagedFileError, Sha256, decode_json


@dataclass(frozen=True)
class _Input:
    sha256: Sha256


@dataclass(frozen=True)
class _Plugin:
    digest: Annotated[str, msgspec.Meta(pattern="^[0-9a-f]+$")]


@dataclass(frozen=True)
class _SpecInputs:
    """Inputs and plug-ins of a spec."""

    inputs: dict[str, _Input] = field(default_factory=dict)
    plugins: dict[str, _Plugin] = field(default_factory=dict)


@dataclass(frozen=True)
class _Source:
    """Stored source of a plug-in, with its files in Base64."""

    module: str
    installed: bool
    files: dict[str, str]


def input_path(sha256: str) -> str:
    """Return the path of the input with this checksum, or raise a ValueError for an invalid one."""
    if not re.fullmatch(r"[0-9a-f]{64}", sha256):
        raise ValueError(f"sha256 {sha256!r}: expected 64 hexadecimal digits")
    return f"{INPUTS}/{sha256}"


def plugin_path(digest: str) -> str:
    """Return the path of a plug-in's source, or raise a ValueError for an invalid digest."""
    if not re.fullmatch(r"[0-9a-f]+", digest):
        raise ValueError(f"digest {digest!r}: expected hexadecimal digits")
    return f"{INPUTS}/plugin-{digest}.json"


def store_input(store: Store, data: bytes) -> None:
    """Store the content of an input file, unless it is already stored."""
    path = input_path(hashlib.sha256(data).hexdigest())
    if not store.exists(path):
        store.write_bytes(path, data)


def read_input(store: Store, sha256: str) -> bytes:
    """Return the content of a stored input file, or raise a DamagedFileError."""
    data = store.read_bytes(input_path(sha256))
    if hashlib.sha256(data).hexdigest() != sha256:
        raise DamagedFileError(f"{store.where(input_path(sha256))} is damaged: its sha256 is not its name")
    return data


def store_plugin(store: Store, source: PluginSource) -> None:
    """Store the source of a plug-in for reference; the stored source is never executed."""
    path = plugin_path(source.digest)
    if store.exists(path):
        return
    files = {name: base64.b64encode(code).decode() for name, code in sorted(source.files.items())}
    content = {"module": source.module, "installed": source.installed, "files": files}
    store.write_bytes(path, json.dumps(content, indent=1).encode())


def read_plugin(store: Store, digest: str) -> PluginSource:
    """Return the stored source of a plug-in, or raise a DamagedFileError."""
    where = store.where(plugin_path(digest))
    content = decode_json(store.read_bytes(plugin_path(digest), MOST_FILE_BYTES), _Source, where)
    try:
        files = {name: base64.b64decode(code) for name, code in content.files.items()}
        source = PluginSource(content.module, files, content.installed)
        actual = source.digest
    except (ValueError, SyntaxError, RecursionError) as error:
        raise DamagedFileError(f"{where} is damaged: {error!r:.200}") from error
    if actual != digest:
        raise DamagedFileError(f"{where} is damaged: its source hashes to {actual}")
    return source


def stored_inputs(store: Store, runs: Iterable[RunRecord]) -> list[str]:
    """Return the paths of the stored inputs and plug-ins of `runs`."""
    paths: set[str] = set()
    for run in runs:
        spec = _read_by(run)
        paths |= {input_path(file.sha256) for file in spec.inputs.values()}
        paths |= {plugin_path(plugin.digest) for plugin in spec.plugins.values()}
    return sorted(paths & set(store.files(INPUTS)))


def damaged_inputs(store: Store, runs: Iterable[RunRecord]) -> Iterator[tuple[str, str, str]]:
    """Yield the path, problem and run id of each missing or damaged input."""
    needed = {input_path(file.sha256): run.run_id for run in runs for file in _read_by(run).inputs.values()}
    present = set(store.files(INPUTS))
    for path in sorted(set(needed) - present):
        yield path, "it is missing, and the run reads it", needed[path]
    for path in sorted(present):
        name = path.removeprefix(f"{INPUTS}/")
        digest = name.removeprefix("plugin-").removesuffix(".json")
        try:
            if name == digest:
                read_input(store, name)
            else:
                read_plugin(store, digest)
        except (OSError, ValueError) as error:
            yield path, str(error), needed.get(path, "")


def _read_by(run: RunRecord) -> _SpecInputs:
    """Return the inputs and plug-ins of a run; empty if its spec is invalid."""
    try:
        return decode_json(run.spec, _SpecInputs, f"the spec of run {run.run_id}")
    except DamagedFileError:
        return _SpecInputs()
