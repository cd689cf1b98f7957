"""Completeness of a release, which it needs to ship with the package, beside being whole."""

from __future__ import annotations

from collections.abc import Iterator

from analysis.baselines.catalogue import Baseline
from analysis.baselines.manifest import BaselineKind
from analysis.data.frames import Frames
from tma_ray.results import RunStatus

MOST_BYTES = 15_000_000
"""Size up to which releases ship with the package."""

FEWEST_SEEDS = 3
"""Seeds that every cell needs."""

COMBINATION = [
    "campaign",
    "experiment",
    "environment",
    "challenge",
    "embodiment",
    "student",
    "expert_knowledge",
]
"""Columns of cells that teachers have in common to be compared."""


def lacking(baseline: Baseline) -> list[str]:
    """Returns what a release lacks to be complete, in words; empty if nothing.

    Complete is a release of whole campaigns under a licence: every planned run is done, in each campaign the
    teachers of a combination of challenge, body, student and level have the same seeds, of which there are at
    least 3; all runs are of one version of the benchmark; no attempt names a machine; it has at most 15 MB.

    Raises:
        BaselineError: it has no runs, being published means and deviations.
    """
    if baseline.manifest.kind is not BaselineKind.RUNS:
        return ["it has no runs, only published results"]
    return [*_of_manifest(baseline), *_of_runs(baseline.frames())]


def _of_manifest(baseline: Baseline) -> Iterator[str]:
    manifest = baseline.manifest
    if manifest.partial:
        yield f"runs are missing: {manifest.partial}"
    if not manifest.licence:
        yield "it has no licence: release it with --licence"
    size = sum(file.size for file in manifest.files)
    if size > MOST_BYTES:
        yield f"it has {size:,} bytes, more than {MOST_BYTES:,}: release it with --lean"
    versions = manifest.benchmark_versions
    if len(versions) != 1 or 0 in versions:
        found = ", ".join(map(str, versions)) or "none"
        yield f"its runs are of these versions of the benchmark: {found}; expected one"


def _of_runs(frames: Frames) -> Iterator[str]:
    unfinished = [run.run.run_id for run in frames.results.runs() if run.status is not RunStatus.DONE]
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
