"""The files that runs of a root read, and the sources of their plug-ins, kept by content below ``inputs``."""

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
from tma_ray.support.decoding import MOST_BYTES, DamagedFileError, Sha256, decode_json


@dataclass(frozen=True)
class _Input:
    sha256: Sha256


@dataclass(frozen=True)
class _Plugin:
    digest: Annotated[str, msgspec.Meta(pattern="^[0-9a-f]+$")]


@dataclass(frozen=True)
class _Read:
    """The part of a spec that names what its run reads."""

    inputs: dict[str, _Input] = field(default_factory=dict)
    plugins: dict[str, _Plugin] = field(default_factory=dict)


@dataclass(frozen=True)
class _Source:
    """A plug-in's source as it is kept: files in base 64."""

    module: str
    installed: bool
    files: dict[str, str]


def input_path(sha256: str) -> str:
    """Path of the file with this content; a ValueError for what is not a hexadecimal SHA-256."""
    if not re.fullmatch(r"[0-9a-f]{64}", sha256):
        raise ValueError(f"sha256 {sha256!r}: expected 64 hexadecimal digits")
    return f"{INPUTS}/{sha256}"


def plugin_path(digest: str) -> str:
    """Path of the source of a plug-in; a ValueError for what is not a hexadecimal digest."""
    if not re.fullmatch(r"[0-9a-f]+", digest):
        raise ValueError(f"digest {digest!r}: expected hexadecimal digits")
    return f"{INPUTS}/plugin-{digest}.json"


def keep_input(store: Store, data: bytes) -> None:
    """Write the content of a file, unless it is there."""
    path = input_path(hashlib.sha256(data).hexdigest())
    if not store.exists(path):
        store.write_bytes(path, data)


def read_input(store: Store, sha256: str) -> bytes:
    """Return the content of a file that was kept.

    Raises:
        FileNotFoundError: it was not.
        DamagedFileError: it is not what was written.
    """
    data = store.read_bytes(input_path(sha256))
    if hashlib.sha256(data).hexdigest() != sha256:
        raise DamagedFileError(f"{store.where(input_path(sha256))} is damaged: its sha256 is not its name")
    return data


def keep_plugin(store: Store, source: PluginSource) -> None:
    """Write the source of a plug-in, for others to read; nothing runs it from there."""
    path = plugin_path(source.digest)
    if store.exists(path):
        return
    files = {name: base64.b64encode(code).decode() for name, code in sorted(source.files.items())}
    content = {"module": source.module, "installed": source.installed, "files": files}
    store.write_bytes(path, json.dumps(content, indent=1).encode())


def read_plugin(store: Store, digest: str) -> PluginSource:
    """Return the source of a plug-in that was kept.

    Raises:
        FileNotFoundError: it was not.
        DamagedFileError: it is not what was written.
    """
    where = store.where(plugin_path(digest))
    content = decode_json(store.read_bytes(plugin_path(digest), MOST_BYTES), _Source, where)
    try:
        files = {name: base64.b64decode(code) for name, code in content.files.items()}
        source = PluginSource(content.module, files, content.installed)
        found = source.digest
    except (ValueError, SyntaxError, RecursionError) as error:
        raise DamagedFileError(f"{where} is damaged: {error!r:.200}") from error
    if found != digest:
        raise DamagedFileError(f"{where} is damaged: its source hashes to {found}")
    return source


def kept_files(store: Store, runs: Iterable[RunRecord]) -> list[str]:
    """Return the paths of what a root keeps of the inputs and plug-ins of `runs`."""
    wanted: set[str] = set()
    for run in runs:
        read = _read_by(run)
        wanted |= {input_path(file.sha256) for file in read.inputs.values()}
        wanted |= {plugin_path(plugin.digest) for plugin in read.plugins.values()}
    return sorted(wanted & set(store.files(INPUTS)))


def damaged_inputs(store: Store, runs: Iterable[RunRecord]) -> Iterator[tuple[str, str, str]]:
    """Yield path, problem and run id of each input that is missing or is not what was written."""
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


def _read_by(run: RunRecord) -> _Read:
    """Return the files that the spec of a run names: none for any other text."""
    try:
        return decode_json(run.spec, _Read, f"the spec of run {run.run_id}")
    except DamagedFileError:
        return _Read()
