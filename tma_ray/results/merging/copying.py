"""Copying what a root says of its runs to another place, files merged, damage left behind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Final

import pyarrow as pa
import pyarrow.compute as pc

from tma_ray.decoding import DamagedFileError
from tma_ray.results.inputs import kept_files
from tma_ray.results.inspection import Inspector
from tma_ray.results.layout import POLICIES, TABLES, create_root, manifest_path
from tma_ray.results.manifest import Manifest
from tma_ray.results.merging.packing import WHOLE, Contents, experiments_of, grouped, pack
from tma_ray.results.merging.shared_files import UNREADABLE
from tma_ray.results.parquet import decode, encode
from tma_ray.results.reader import Results
from tma_ray.results.records import RunStatus
from tma_ray.results.schema import Table
from tma_ray.results.storage.store import Store

POLICY_FILES: Final = (".json", ".safetensors")
"""Endings of the files of policies that are copied: nothing that runs when it is read."""


@dataclass(frozen=True)
class Copy:
    """Runs and files that a copy of a root lacks.

    Attributes:
        policy_files: that were left out, since they are neither JSON nor safetensors.
        damaged: a message for each run and file that was left out, since it is damaged.
    """

    policy_files: tuple[str, ...]
    damaged: tuple[str, ...]


def copy_merged(results: Results, target: Store, contents: Contents = WHOLE) -> Copy:
    """Copies all that a root says of its runs, and their policies, to an empty place, files merged.

    What is damaged is left out.

    Args:
        results: the root.
        target: where another one is made.
        contents: what is copied.

    Raises:
        DamagedFileError: a file was written by a newer version, with columns that would be lost.
        ResultsRootError: `target` is not empty.
    """
    sound, damaged = sound_runs(results, contents)
    ours = pa.array([manifest.run.run_id for manifest in sound], pa.string())
    create_root(target)
    for name, manifests in grouped(sound, experiments_of(results)).items():
        for manifest in pack(results, manifests, target, name, lambda: None, contents):
            target.write_bytes(manifest_path(manifest.run.run_id), manifest.to_bytes())
    for path in results.store.files(f"{TABLES}/{Table.CELLS}"):
        try:
            cells = decode(Table.CELLS, results.store.read_bytes(path))
        except UNREADABLE as error:
            damaged.append(f"{path}: {error}")
        else:
            if not contents.unfinished:
                cells = cells.filter(pc.is_in(cells["run_id"].cast(pa.string()), ours))
            target.write_bytes(path, encode(Table.CELLS, cells))
    left_out = copy_beside(results, target, sound, contents)
    return Copy(left_out, tuple(dict.fromkeys([*results.problems, *damaged])))


def copy_beside(
    results: Results, target: Store, manifests: Sequence[Manifest], contents: Contents
) -> tuple[str, ...]:
    """Copies what runs read, and their policies; returns files of policies that were left out as unsafe."""
    for path in kept_files(results.store, (manifest.run for manifest in manifests)):
        target.write_bytes(path, results.store.read_bytes(path))
    if not contents.policies:
        return ()
    ours = {manifest.run.run_id for manifest in manifests}
    left_out = []
    for path in results.store.files(POLICIES):
        if path.endswith(POLICY_FILES) and PurePosixPath(path).parts[1] in ours:
            target.write_bytes(path, results.store.read_bytes(path))
        else:
            left_out.append(path)
    return tuple(left_out)


def sound_runs(results: Results, contents: Contents) -> tuple[list[Manifest], list[str]]:
    """Returns the runs of a root that are to be copied and whose files are whole, and the damage of others.

    Raises:
        DamagedFileError: a file was written by a newer version, with columns that would be lost.
    """
    sound: list[Manifest] = []
    damaged: list[str] = []
    wanted = [run for run in results.runs() if contents.unfinished or run.status is RunStatus.DONE]
    for manifest, found in Inspector(results.store).inspect_all(wanted):
        if found.newer:
            raise DamagedFileError(newer_version(results.store, found.newer[0]))
        damaged += map(str, found.damage)
        sound += [] if found.damage else [manifest]
    return sound, damaged


def newer_version(store: Store, path: str) -> str:
    """Returns why a file with columns that this version does not know is neither merged nor copied."""
    return (
        f"{store.where(path)} was written by a newer tma_ray, with columns that this one would lose: it was "
        f"left as it is; use that version"
    )
