"""Sources of results: roots and baselines, by folder, address or name, read as one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

from analysis.baselines.catalogue import Baseline, as_baseline
from analysis.baselines.manifest import BaselineError, BaselineKind
from analysis.data.frames import Frames, load
from analysis.data.joining import joined
from analysis.data.reference import is_baseline

Sources: TypeAlias = str | Path | Sequence[str | Path]
"""Results roots or baselines: folders, ``s3://`` or ``gs://`` addresses, names of baselines."""


def read(sources: Sources) -> Frames:
    """Returns the runs of all `sources` together, as those of one root.

    Raises:
        BaselineError: a damaged baseline, or one of published means, without runs.
        ResultsRootError: nothing of that name or at that place.
        ValueError: none is given.
    """
    places = places_of(sources)
    return joined([read_one(place) for place in places])


def places_of(sources: Sources) -> tuple[str | Path, ...]:
    """Returns `sources` one by one, each once.

    Raises:
        ValueError: none is given.
    """
    places = (sources,) if isinstance(sources, str | Path) else tuple(dict.fromkeys(sources))
    if not places:
        raise ValueError("no results: expected at least one results root or name of a baseline")
    return places


def own_teachers(sources: Sources, frames: Frames) -> frozenset[str]:
    """Returns the teachers, but Random, of the results roots that are read with baselines, if any are.

    Args:
        sources: results roots and baselines.
        frames: results of `read`.
    """
    places = places_of(sources)
    roots = [place for place in places if as_baseline(place) is None]
    if not 0 < len(roots) < len(places):
        return frozenset()
    run_ids = {run_id for root in roots for run_id in load(root).cells["run_id"]}
    teachers = frames.cells.loc[frames.cells["run_id"].isin(run_ids), "teacher"].unique()
    return frozenset(str(teacher) for teacher in teachers if not is_baseline(str(teacher)))


def published(sources: Sources) -> Baseline | None:
    """Returns the baseline of published means and deviations that `sources` is, None if it has runs."""
    places = places_of(sources)
    baseline = as_baseline(places[0]) if len(places) == 1 else None
    return baseline if baseline is not None and _without_runs(baseline) else None


def read_one(place: str | Path) -> Frames:
    """Returns the runs of a results root or a baseline.

    Raises:
        BaselineError: a damaged baseline, or one of published means, without runs.
        ResultsRootError: nothing of that name or at that place.
    """
    baseline = as_baseline(place)
    if baseline is None:
        return load(place)
    if _without_runs(baseline):
        raise BaselineError(
            f"{place} has published means and deviations only, and no runs to pool or to test with: set it "
            f"beside yours with tma-ray compare, or ask for its tables and figures alone"
        )
    return baseline.frames()


def _without_runs(baseline: Baseline) -> bool:
    return baseline.manifest.kind is BaselineKind.PUBLISHED
