"""Verification of baselines, their completeness, and publication at an address."""

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
from analysis.data.columns import CELL
from analysis.data.frames import Frames
from tma_ray import results

ENDINGS: Final = (".json", ".parquet", ".safetensors", ".md", ".jsonl.gz")
"""Endings of the files of a baseline, except for inputs of its runs: nothing that runs when it is read."""


@dataclass(frozen=True)
class Verification:
    """Result of a verification.

    Attributes:
        baseline: baseline that was verified.
        damage: differences from what was released.
    """

    baseline: Baseline
    damage: tuple[results.Damage, ...]

    @property
    def problems(self) -> tuple[str, ...]:
        """One message for each damage; empty if the baseline is whole."""
        return tuple(map(str, self.damage))

    @property
    def whole(self) -> bool:
        """True if every file is as released, and none was added."""
        return not self.damage


def verify(name: str | Path) -> Verification:
    """Compare a baseline with its manifest, and read its tables.

    Raises:
        BaselineError: no baseline of that name or place, or its manifest cannot be read.
    """
    baseline = find_baseline(name)
    store = results.Store.open(baseline.place)
    damage = list(_damaged_files(store, baseline))
    known = {each.path for each in damage}
    if baseline.manifest.kind is BaselineKind.RUNS:
        damage += [each for each in _damaged_runs(store, baseline) if each.path not in known]
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
        if not file.path.endswith(ENDINGS) and not file.path.startswith(f"{results.INPUTS}/"):
            yield results.Damage(file.path, "a baseline does not hold files of this kind")
        try:
            results.read_checked(store, file.path, file.sha256)
        except results.ObjectStoreError:  # which says nothing of the file
            raise
        except (OSError, results.DamagedFileError) as error:
            yield results.Damage(file.path, results.damage_reason(error, store.where(file.path)))


def _damaged_runs(store: results.Store, baseline: Baseline) -> Iterator[results.Damage]:
    try:
        found = results.verify_root(store)
    except results.ResultsRootError as error:
        yield results.Damage(BASELINE_FILE, str(error))
        return
    yield from found.damage
    yield from (results.Damage(path, "it belongs to no run") for path in found.unlisted)
    recorded = {file.path: file.sha256 for file in baseline.manifest.files}
    for path, sha256 in found.files:
        if recorded.get(path) != sha256:
            yield results.Damage(path, "a run refers to another file than the recorded one")
    counted = baseline.manifest.holds.get("runs")
    if found.runs != counted:
        yield results.Damage(BASELINE_FILE, f"{found.runs} of its {counted} runs can be read")


MOST_BYTES = 15_000_000
"""Size up to which releases ship with the package."""

FEWEST_SEEDS = 3
"""Seeds that every cell needs."""

COMBINATION = ["campaign", "experiment", *CELL]
"""Columns of cells that teachers have in common to be compared."""


def lacking(baseline: Baseline) -> list[str]:
    """Return the gaps of a release that is not complete, in words; empty if it is.

    Complete is a release of whole campaigns under a licence: every planned run is done, in each campaign the
    teachers of a combination of challenge, body, student and level have the same seeds, of which there are at
    least 3; all runs are of one version of the benchmark; no attempt names a machine; it has at most 15 MB.
    """
    manifest = baseline.manifest
    if manifest.kind is not BaselineKind.RUNS:
        return ["it has no runs, only published results"]
    found = [f"runs are missing: {manifest.partial}"] if manifest.partial else []
    if not manifest.licence:
        found.append("it has no licence: release it with --licence")
    size = sum(file.size for file in manifest.files)
    if size > MOST_BYTES:
        found.append(f"it has {size:,} bytes, more than {MOST_BYTES:,}: release it with --lean")
    versions = manifest.benchmark_versions
    if len(versions) != 1 or 0 in versions:
        words = ", ".join(map(str, versions)) or "none"
        found.append(f"its runs are of these versions of the benchmark: {words}; expected one")
    return [*found, *_lacking_runs(baseline.frames())]


def _lacking_runs(frames: Frames) -> Iterator[str]:
    """Yield runs that are not done, names of machines, and seeds that teachers lack."""
    unfinished = [run.run.run_id for run in frames.results.runs() if run.status is not results.RunStatus.DONE]
    if unfinished:
        yield f"{len(unfinished)} runs are not done, as {unfinished[0]}"
    if len(frames.attempts) and (frames.attempts["host"].astype(str) != "").any():
        yield "its attempts name machines: release it with --lean"
    for key, rows in frames.cells.groupby(COMBINATION, sort=True):
        place = " ".join(str(value) for value in key[2:])
        seeds = {str(teacher): frozenset(own["seed"]) for teacher, own in rows.groupby("teacher")}
        everywhere = frozenset().union(*seeds.values())
        for teacher, own in seeds.items():
            if own != everywhere:
                absent = ", ".join(map(str, sorted(everywhere - own)))
                yield f"{place}: {teacher} lacks the seeds {absent}, which others have"
        if len(everywhere) < FEWEST_SEEDS:
            yield f"{place}: {len(everywhere)} seeds, fewer than {FEWEST_SEEDS}"


def publish(folder: str | Path, address: str) -> str:
    """Copy a release from a disk to an address, then read all of it back and compare the checksums.

    Its ``baseline.json`` comes last: what has none is not a release. An upload that was interrupted is
    continued by the same call.

    Args:
        folder: folder of the release.
        address: address of the release, such as ``s3://bucket/mine-1.0`` or ``hf://datasets/me/mine-1.0``.

    Returns:
        The address.

    Raises:
        BaselineError: the folder is not a release, or a damaged one, or `check_address` refuses the address.
        ObjectStoreError: errors of `check_address`, or the upload fails.
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
    """Check that a release can be published at an address; leave nothing there.

    Args:
        address: address of the release.
        paths: its files, which may lie there already, after an interruption; None if they are not known yet.

    Raises:
        BaselineError: it is a folder of this machine, a release lies there, or other files do.
        ObjectStoreError: nothing answers there, or nothing can be written.
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


def _refuse_damage(place: str | Path, remedy: str) -> None:
    problems = verify(place).problems
    if problems:
        raise BaselineError(f"{place} is not as it was packed: {problems[0]}; {remedy}")
