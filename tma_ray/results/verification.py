"""Comparison of a results root with its manifests: against accidents, not against malice.

Whoever can write to a root can write checksums that fit. What is found is what a disk, a copy that was cut
short, a merge of folders or an editor did.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import Any, Final

import pyarrow as pa
import pyarrow.compute as pc

from tma_ray.decoding import decode_json
from tma_ray.results.inputs import damaged_inputs
from tma_ray.results.inspection import Damage, Inspector, damage_reason, lost_manifests
from tma_ray.results.layout import MANIFESTS, POLICIES, TABLES, check_root, policy_folder
from tma_ray.results.manifest import Manifest, PartFile, load_manifest
from tma_ray.results.merging.shared_files import UNREADABLE
from tma_ray.results.parquet import decode
from tma_ray.results.schema import DATA_TABLES, Table
from tma_ray.results.storage.store import Store

SPEC_FILE: Final = "spec.json"
"""Beside every saved policy, the spec of its run."""


@dataclass(frozen=True)
class RootVerification:
    """Findings in a results root.

    Attributes:
        runs: how many have a manifest that can be read.
        files: path and sha256 of each file that their manifests list.
        damage: what is not as it was written.
        unlisted: files of tables and policies that belong to no run; readers ignore them.
    """

    runs: int
    files: tuple[tuple[str, str], ...]
    damage: tuple[Damage, ...] = ()
    unlisted: tuple[str, ...] = field(default=())


def verify_root(store: Store) -> RootVerification:
    """Compares all that a results root holds with its manifests.

    Raises:
        ResultsRootError: the root does not exist, or is one of another version.
    """
    check_root(store)
    manifests, damage = _manifests(store)
    lost = lost_manifests(store, manifests, {PurePosixPath(each.path).stem for each in damage})
    damage += [Damage(path, str(error), PurePosixPath(path).stem) for path, error in lost.items()]
    inspector = Inspector(store, raise_refusals=False)
    for _, inspection in inspector.inspect_all(manifests):
        damage += inspection.damage
    damage += _listed_twice(manifests)
    damage += _foreign_rows(store, manifests)
    damage += _tables_about_runs(store)
    damage += _foreign_policies(store, manifests)
    damage += (Damage(*found) for found in damaged_inputs(store, [manifest.run for manifest in manifests]))
    listed = {(file.path, file.sha256) for manifest in manifests for file in manifest.files}
    known = {manifest.run.run_id for manifest in manifests}
    unlisted = tuple(_unlisted(store, {path for path, _ in listed}, known))
    return RootVerification(len(manifests), tuple(sorted(listed)), tuple(dict.fromkeys(damage)), unlisted)


def _manifests(store: Store) -> tuple[list[Manifest], list[Damage]]:
    found, damage = [], []
    for path in store.files(MANIFESTS):
        try:
            found.append(load_manifest(store, path))
        except UNREADABLE as error:
            damage.append(Damage(path, damage_reason(error, store.where(path))))
    return found, damage


def _listed_twice(manifests: Iterable[Manifest]) -> Iterator[Damage]:
    """Yields files, or rows of shared files, that two runs claim."""
    claims: dict[str, list[tuple[int, int, str]]] = {}
    for manifest in manifests:
        for file in manifest.files:
            first = file.first or 0
            claims.setdefault(file.path, []).append((first, first + file.rows, manifest.run.run_id))
    for path, ranges in claims.items():
        end, last = 0, ""
        for first, after, run_id in sorted(ranges):
            if first < end:
                yield Damage(path, f"its rows from {first:,} on are also listed for run {last}", run_id)
            end, last = max((end, last), (after, run_id))


def _foreign_rows(store: Store, manifests: Iterable[Manifest]) -> Iterator[Damage]:
    """Yields rows of shared files that are listed for a run and name another."""
    shared: dict[str, list[tuple[PartFile, str]]] = {}
    for manifest in manifests:
        for file in manifest.files:
            if file.first is not None and file.rows:
                shared.setdefault(file.path, []).append((file, manifest.run.run_id))
    for path, slices in shared.items():
        try:
            ids = decode(slices[0][0].table, store.read_bytes(path), ["run_id"])["run_id"]
        except UNREADABLE:
            continue  # told already
        for file, run_id in slices:
            mine = ids.slice(file.first, file.rows).cast(pa.string())
            if len(mine) < file.rows or pc.unique(mine).to_pylist() != [run_id]:
                yield Damage(path, f"rows {file.first:,} and following are not this run's", run_id)


def _tables_about_runs(store: Store) -> Iterator[Damage]:
    for table in Table:
        if table in DATA_TABLES:
            continue
        for path in store.files(f"{TABLES}/{table}"):
            try:
                decode(table, store.read_bytes(path))
            except UNREADABLE as error:
                yield Damage(path, damage_reason(error, store.where(path)))


def _foreign_policies(store: Store, manifests: Iterable[Manifest]) -> Iterator[Damage]:
    """Yields policies whose spec is not that of their run."""
    saved = set(store.files(POLICIES))
    for manifest in manifests:
        path = f"{policy_folder(manifest.run.run_id)}/{SPEC_FILE}"
        if path not in saved:
            continue
        try:
            saved_spec = decode_json(store.read_bytes(path), dict[str, Any], path)
        except UNREADABLE as error:
            yield Damage(path, damage_reason(error, store.where(path)), manifest.run.run_id)
            continue
        if saved_spec != decode_json(manifest.run.spec, dict[str, Any], path):
            yield Damage(path, "it is not the spec of its run", manifest.run.run_id)


def _unlisted(store: Store, listed: set[str], run_ids: set[str]) -> Iterator[str]:
    for table in DATA_TABLES:
        yield from (path for path in store.files(f"{TABLES}/{table}") if path not in listed)
    yield from (path for path in store.files(POLICIES) if PurePosixPath(path).parts[1] not in run_ids)
