"""Trials of the teachers that joined a release by one: its runs, judged as trials are."""

from dataclasses import replace

from analysis.baselines.catalogue import Baseline
from analysis.trials.design import Design, ended_runs, make_design, released_runs
from analysis.trials.standing import Look, looks_at


def joined_by_trial(baseline: Baseline) -> list[tuple[Design, Look]]:
    """Return the design and the last look of each teacher that joined a release by a trial, by name.

    Each is compared with Random and the best teacher of the core, so that one that joins changes nothing of
    another. Their runs have seeds of their own, which follow those of the two. Weights, least variances and
    boundaries are today's, also of trials that were begun by an earlier version.

    Raises:
        ValueError: a teacher cannot be tried against the core; see `make_design`.
    """
    frames = baseline.frames()
    if not frames.core:
        return []
    core_frames = replace(frames, cells=frames.cells[frames.cells["core"]])
    design, released = make_design("", baseline, core_frames), released_runs(core_frames)
    everything = ended_runs(frames)
    theirs = everything.loc[everything["teacher"].isin(design.references), "seed"]
    first = int(theirs.max()) + 1
    design = replace(design, seeds=tuple(range(first, first + design.looks[-1])))
    own = everything[~everything["teacher"].isin(core_frames.cells["teacher"])]
    found = []
    for teacher, runs in own.groupby("teacher"):
        design = replace(design, teacher=str(teacher))
        looks = looks_at(design, released, runs)
        found += [(design, looks[-1])] if looks else []
    return found
