"""Whether a baseline is what was released: every file, and nothing else."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Final

import pyarrow as pa

from analysis.baselines.catalogue import Baseline, find_baseline
from analysis.baselines.manifest import BASELINE_FILE, BaselineFile, BaselineKind
from tma_ray.results import INPUTS, ResultsRootError, Store, read_published, verify_root

ENDINGS: Final = (".json", ".parquet", ".safetensors", ".md")
"""What files of a baseline are, beside the inputs of its runs: nothing that runs when it is read."""


@dataclass(frozen=True)
class Verification:
    """What was found.

    Attributes:
        baseline: which one was looked at.
        problems: one message each; empty if it is whole.
    """

    baseline: Baseline
    problems: tuple[str, ...]

    @property
    def whole(self) -> bool:
        """Whether every file is what was released, and there is no other."""
        return not self.problems


def verify(name: str | Path) -> Verification:
    """Compares a baseline with its manifest, and reads its tables.

    Args:
        name: of a known baseline, or its folder or address.

    Raises:
        BaselineError: there is no such baseline, or its manifest cannot be read.
    """
    baseline = find_baseline(name)
    store = Store.open(baseline.place)
    return Verification(baseline, tuple(dict.fromkeys(_problems(store, baseline))))


def _problems(store: Store, baseline: Baseline) -> Iterator[str]:
    files = {file.path: file for file in baseline.manifest.files}
    for path in sorted(set(store.files()) - set(files) - {BASELINE_FILE}):
        yield f"{path} is not of this baseline"
    for file in files.values():
        if PurePosixPath(file.path).suffix not in ENDINGS and not file.path.startswith(f"{INPUTS}/"):
            yield f"{file.path}: a baseline does not hold files of this kind"
        yield from _damage(store, file)
    if baseline.manifest.kind is BaselineKind.RUNS:
        yield from _damaged_runs(store, baseline)
        return
    try:
        read_published(store)
    except (OSError, ValueError, pa.ArrowException) as error:
        yield f"its results cannot be read: {error}"


def _damage(store: Store, file: BaselineFile) -> Iterator[str]:
    try:
        data = store.read_bytes(file.path)
    except FileNotFoundError:
        yield f"{file.path} is missing"
        return
    if len(data) != file.size:
        yield f"{file.path} has {len(data):,} bytes, not {file.size:,}"
    elif hashlib.sha256(data).hexdigest() != file.sha256:
        yield f"{file.path} is damaged: its sha256 is not the recorded one"


def _damaged_runs(store: Store, baseline: Baseline) -> Iterator[str]:
    try:
        found = verify_root(store)
    except ResultsRootError as error:
        yield str(error)
        return
    yield from map(str, found.damage)
    yield from (f"{path} belongs to no run" for path in found.unlisted)
    recorded = {file.path: file.sha256 for file in baseline.manifest.files}
    for path, sha256 in found.files:
        if recorded.get(path) != sha256:
            yield f"a run refers to another {path} than the recorded one"
    counted = baseline.manifest.holds.get("runs")
    if found.runs != counted:
        yield f"it has {found.runs} runs that can be read, not {counted}"
