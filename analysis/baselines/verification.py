"""Verification, completeness checks and publication of baselines."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pyarrow as pa

from analysis.baselines.catalogue import (
    BASELINE_FILE,
    Baseline,
    BaselineError,
    BaselineKind,
    BaselineManifest,
    find_baseline,
)
from analysis.data.columns import CELL_COLUMNS
from analysis.data.frames import Frames
from tma_ray import results

RELEASED_SUFFIXES: Final = (".json", ".parquet", ".safetensors", ".md", ".jsonl.gz")
"""Allowed suffixes of a baseline's files, none of them executable; inputs of its runs may have others."""


@dataclass(frozen=True)
class Verification:
    """Result of verifying a baseline.

    Attributes:
        baseline: baseline that was verified.
        damage: differences from what was released.
    """

    baseline: Baseline
    damage: tuple[results.Damage, ...]

    @property
    def problems(self) -> tuple[str, ...]:
        """Messages, one for each `Damage` found."""
        return tuple(map(str, self.damage))

    @property
    def whole(self) -> bool:
        """True if no file was changed, removed or added."""
        return not self.damage


def verify(name: str | Path) -> Verification:
    """Check the files of a baseline against its manifest, and check that its tables can be read.

    Raises:
        BaselineError: if the baseline is missing or its manifest unreadable.
    """
    baseline = find_baseline(name)
    store = results.Store.open(baseline.location)
    damage = list(_damaged_files(store, baseline))
    paths = {entry.path for entry in damage}
    if baseline.manifest.kind is BaselineKind.RUNS:
        damage += [entry for entry in _damaged_runs(store, baseline) if entry.path not in paths]
    else:
        try:
            results.read_published(store)
        except results.ObjectStoreError:
            raise
        except (OSError, ValueError, pa.ArrowException) as error:
            damage.append(results.Damage(BASELINE_FILE, f"its results cannot be read: {error}"))
    return Verification(baseline, tuple(damage))


def _damaged_files(store: results.Store, baseline: Baseline) -> Iterator[results.Damage]:
    files = {file.path: file for file in baseline.manifest.files}
    for path in sorted(set(store.files()) - set(files) - {BASELINE_FILE}):
        yield results.Damage(path, "it is not of this baseline")
    for file in files.values():
        if not file.path.endswith(RELEASED_SUFFIXES) and not file.path.startswith(f"{results.INPUTS}/"):
            yield results.Damage(file.path, "a baseline does not hold files of this kind")
        try:
            results.read_checked(store, file.path, file.sha256)
        except results.ObjectStoreError:  # not damage, but an outage
            raise
        except (OSError, results.DamagedFileError) as error:
            yield results.Damage(file.path, results.damage_reason(error, store.where(file.path)))


def _damaged_runs(store: results.Store, baseline: Baseline) -> Iterator[results.Damage]:
    try:
        verified = results.verify_root(store)
    except results.ResultsRootError as error:
        yield results.Damage(BASELINE_FILE, str(error))
        return
    yield from verified.damage
    yield from (results.Damage(path, "it belongs to no run") for path in verified.unlisted)
    recorded = {file.path: file.sha256 for file in baseline.manifest.files}
    for path, sha256 in verified.files:
        if recorded.get(path) != sha256:
            yield results.Damage(path, "a run refers to another file than the recorded one")
    count = baseline.manifest.holds.get("runs")
    if verified.runs != count:
        yield results.Damage(BASELINE_FILE, f"{verified.runs} of its {count} runs can be read")


MOST_RELEASED_BYTES = 15_000_000  # maximum size of a release shipped with the package
FEWEST_SEEDS = 3  # minimum number of seeds in every cell

COMBINATION = ["campaign", "experiment", *CELL_COLUMNS]
"""Columns that identify a cell, in which all teachers of a complete release have the same seeds."""


def lacking(baseline: Baseline) -> list[str]:
    """Return the reasons why a release is incomplete.

    In a complete release all planned runs are done under one version of the benchmark, all teachers of a cell
    have the same seeds, at least 3, attempts name no machines, there is a licence, and the size is limited.
    """
    manifest = baseline.manifest
    if manifest.kind is not BaselineKind.RUNS:
        return ["it has no runs, only published results"]
    reasons = [f"runs are missing: {manifest.partial}"] if manifest.partial else []
    if not manifest.licence:
        reasons.append("it has no licence: release it with --licence")
    size = sum(file.size for file in manifest.files)
    if size > MOST_RELEASED_BYTES:
        reasons.append(f"it has {size:,} bytes, more than {MOST_RELEASED_BYTES:,}: release it with --lean")
    versions = manifest.benchmark_versions
    if len(versions) != 1 or 0 in versions:
        words = ", ".join(map(str, versions)) or "none"
        reasons.append(f"its runs are of these versions of the benchmark: {words}; expected one")
    return [*reasons, *_lacking_runs(baseline.frames())]


def _lacking_runs(frames: Frames) -> Iterator[str]:
    """Yield messages about unfinished runs, recorded host names, and missing or too few seeds."""
    unfinished = [run.run.run_id for run in frames.results.runs() if run.status is not results.RunStatus.DONE]
    if unfinished:
        yield f"{len(unfinished)} runs are not done, as {unfinished[0]}"
    if len(frames.attempts) and (frames.attempts["host"].astype(str) != "").any():
        yield "its attempts name machines: release it with --lean"
    for key, rows in frames.cells.groupby(COMBINATION, sort=True):
        cell = " ".join(str(value) for value in key[2:])
        seeds = {str(teacher): frozenset(runs["seed"]) for teacher, runs in rows.groupby("teacher")}
        union = frozenset().union(*seeds.values())
        for teacher, present in seeds.items():
            if present != union:
                absent = ", ".join(map(str, sorted(union - present)))
                yield f"{cell}: {teacher} lacks the seeds {absent}, which others have"
        if len(union) < FEWEST_SEEDS:
            yield f"{cell}: {len(union)} seeds, fewer than {FEWEST_SEEDS}"


def publish(folder: str | Path, address: str) -> str:
    """Copy a release from disk to an address, and verify it there.

    An interrupted upload is continued by the same call, since ``baseline.json`` is written last.

    Args:
        folder: folder of the release.
        address: address of the release, such as ``s3://bucket/mine-1.0`` or ``hf://datasets/me/mine-1.0``.

    Returns:
        The address.

    Raises:
        BaselineError: if the folder is not an intact release, or `check_address` raises it.
        ObjectStoreError: if the upload fails, or `check_address` raises it.
    """
    _refuse_damage(folder, "pack it again")
    source, target = results.Store.open(folder), results.Store.open(address)
    paths = [file.path for file in BaselineManifest.load(source).files]
    check_address(address, paths)
    for path in (*paths, BASELINE_FILE):
        target.write_bytes(path, source.read_bytes(path))
    _refuse_damage(address, "delete what is there, and publish it again")
    return address


def check_address(address: str, paths: Collection[str] | None = None) -> None:
    """Check that a release can be published at an address.

    Args:
        address: address of the release.
        paths: files of the release, which may exist after an interruption; None if they are unknown.

    Raises:
        BaselineError: if the address is a local folder, or holds a release or other files.
        ObjectStoreError: if the store is unreachable or not writable.
    """
    if "://" not in address:
        raise BaselineError(f"{address} is not an address: expected one such as s3://bucket/mine-1.0")
    target = results.Store.open(address)
    target.check_access()
    if target.holds(BASELINE_FILE):
        raise BaselineError(
            f"{address} exists: a release is never overwritten; choose another name or address"
        )
    others = set(target.files()) - set(paths) if paths is not None else ()
    if others:
        raise BaselineError(
            f"{address} holds {len(others)} files of something else, such as {min(others)}: choose another"
        )


def _refuse_damage(location: str | Path, remedy: str) -> None:
    problems = verify(location).problems
    if problems:
        raise BaselineError(f"{location} is not as it was packed: {problems[0]}; {remedy}")
