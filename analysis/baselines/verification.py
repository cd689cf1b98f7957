"""Verification of baselines, every file and nothing else: against accidents, not malice."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Final

import pyarrow as pa

from analysis.baselines.catalogue import Baseline, find_baseline
from analysis.baselines.manifest import BASELINE_FILE, FOREIGN_FILES, BaselineKind
from tma_ray.results import (
    INPUTS,
    Damage,
    DamagedFileError,
    ObjectStoreError,
    ResultsRootError,
    Store,
    damage_reason,
    read_checked,
    read_published,
    verify_root,
)

ENDINGS: Final = (".json", ".parquet", ".safetensors", ".md")
"""What files of a baseline are, beside the inputs of its runs: nothing that runs when it is read."""


@dataclass(frozen=True)
class Verification:
    """What was found.

    Attributes:
        baseline: which one was looked at.
        damage: what is not as it was released.
    """

    baseline: Baseline
    damage: tuple[Damage, ...]

    @property
    def problems(self) -> tuple[str, ...]:
        """One message for each damage; empty if the baseline is whole."""
        return tuple(map(str, self.damage))

    @property
    def whole(self) -> bool:
        """Whether every file is what was released, and none was added."""
        return not self.damage


def verify(name: str | Path) -> Verification:
    """Compares a baseline with its manifest, and reads its tables.

    Args:
        name: of a known baseline, or its folder or address.

    Raises:
        BaselineError: no baseline of that name or place, or its manifest cannot be read.
    """
    baseline = find_baseline(name)
    store = Store.open(baseline.place)
    damage = tuple(_damaged_files(store, baseline))
    return Verification(baseline, damage + tuple(_damaged_content(store, baseline, {d.path for d in damage})))


def _damaged_files(store: Store, baseline: Baseline) -> Iterator[Damage]:
    files = {file.path: file for file in baseline.manifest.files}
    for path in sorted(set(store.files()) - set(files) - {BASELINE_FILE} - FOREIGN_FILES):
        yield Damage(path, "it is not of this baseline")
    for file in files.values():
        if PurePosixPath(file.path).suffix not in ENDINGS and not file.path.startswith(f"{INPUTS}/"):
            yield Damage(file.path, "a baseline does not hold files of this kind")
        try:
            read_checked(store, file.path, file.sha256)
        except ObjectStoreError:  # which says nothing of the file
            raise
        except (OSError, DamagedFileError) as error:
            yield Damage(file.path, damage_reason(error, store.where(file.path)))


def _damaged_content(store: Store, baseline: Baseline, known: set[str]) -> Iterator[Damage]:
    """Yields what the tables show to be wrong besides the files that are `known` to be damaged."""
    if baseline.manifest.kind is BaselineKind.RUNS:
        yield from (damage for damage in _damaged_runs(store, baseline) if damage.path not in known)
        return
    try:
        read_published(store)
    except ObjectStoreError:
        raise
    except (OSError, ValueError, pa.ArrowException) as error:
        yield Damage(BASELINE_FILE, f"its results cannot be read: {error}")


def _damaged_runs(store: Store, baseline: Baseline) -> Iterator[Damage]:
    try:
        found = verify_root(store)
    except ResultsRootError as error:
        yield Damage(BASELINE_FILE, str(error))
        return
    yield from found.damage
    yield from (Damage(path, "it belongs to no run") for path in found.unlisted)
    recorded = {file.path: file.sha256 for file in baseline.manifest.files}
    for path, sha256 in found.files:
        if recorded.get(path) != sha256:
            yield Damage(path, "a run refers to another file than the recorded one")
    counted = baseline.manifest.holds.get("runs")
    if found.runs != counted:
        yield Damage(BASELINE_FILE, f"{found.runs} of its {counted} runs can be read")
