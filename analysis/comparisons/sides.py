"""Comparison of one's own teacher with released results: comparable teachers, tests, what stands apart."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.baselines.catalogue import BaselineKind, as_baseline, read
from analysis.comparisons.frame import corrected, from_both_sides, pairwise
from analysis.data.columns import CHALLENGE_LEVEL, COMPARED, CONDITION_LABELS, NAMED, POOLED
from analysis.data.frames import Frames, joined
from analysis.data.identity import disambiguate_names
from analysis.data.reference import is_baseline
from analysis.formatting import amount, listed
from analysis.measures.pooling import parts_of, pooled, result_runs
from analysis.measures.run_measures import evaluations_at, run_measures
from analysis.measures.tested import HEADLINE, PAPERS
from analysis.names import label
from tma_ray.benchmark import MATRICES, TEACHERS
from tma_ray.results import CHIPMUNK, SIMULATED
from tma_ray.support.component_names import base_name


@dataclass(frozen=True)
class Side:
    """Results from one place.

    Attributes:
        name: name that readers know them by.
        engine: simulator of their worlds.
        table: results of `pooling.pooled`, or of `reference.paper_frame`.
        runs: rows of `pooling.pool_runs`, Random at every level; None where only tables are known.
        frames: results that they were made of; None where `runs` is.
    """

    name: str
    engine: str
    table: pd.DataFrame
    runs: pd.DataFrame | None = None
    frames: Frames | None = None


def side_of(frames: Frames, name: str) -> Side:
    """Return the results of a root or a release at the end of its runs."""
    runs, engines = result_runs(frames, run_measures(frames)), []
    for engine in sorted(map(str, runs["engine"].unique())):
        rows = runs[runs["engine"] == engine]
        versions = ", ".join(f"{version:g}" for version in sorted(rows["physics_version"].dropna().unique()))
        engines.append(f"{engine}, physics version {versions}" if engine == CHIPMUNK else engine)
    return Side(name, "; ".join(engines), pooled(runs, [PAPERS]), runs, frames)


def named_jointly(mine: Side, baselines: Sequence[Side]) -> tuple[Side, list[Side], tuple[str, ...]]:
    """Return the sides with names that are unambiguous across all, and a sentence on each split name.

    What one root calls PPO may have other settings, or another version, in another root.
    """
    sides = [mine, *baselines]
    frames = {place: side.frames for place, side in enumerate(sides) if side.frames is not None}
    named, said = disambiguate_names([each.cells for each in frames.values()])
    for (place, each), cells in zip(frames.items(), named, strict=True):
        if not cells[NAMED].equals(each.cells[NAMED]):
            sides[place] = side_of(replace(each, cells=cells), sides[place].name)
    return sides[0], sides[1:], said


def baseline_side(place: str) -> Side:
    """Return the results of a baseline by name, or at a folder or address of a baseline or a root.

    Of published tables those results that pool all that the table has of a challenge.

    Raises:
        BaselineError: a damaged baseline.
        ResultsRootError: nothing of that name or at that place.
    """
    baseline = as_baseline(place)
    name = Path(place).name if baseline is None else baseline.manifest.name
    if baseline is None or baseline.manifest.kind is BaselineKind.RUNS:
        return side_of(read(place), name)
    frame = baseline.published()
    whole = frame.groupby(CHALLENGE_LEVEL)["n"].transform("max") == frame["n"]
    return Side(name, ", ".join(sorted(frame["engine"].unique())), frame[whole].reset_index(drop=True))


def frames_together(mine: Side, baselines: Sequence[Side]) -> Frames:
    """Return the results of all sides that have runs, as those of one root."""
    return joined([side.frames for side in (mine, *baselines) if side.frames is not None])


def together(
    mine: Side, baselines: Sequence[Side], frames: Frames | None = None, *, along: bool = False
) -> pd.DataFrame:
    """Return the runs that may be compared with each other: mine, and those of baselines of the same kind.

    A baseline's teacher that I have run under the same conditions is left out: mine replaces it. Random
    counts at every level, whoever ran it: it uses no expert knowledge. They are rows of `pooling.pool_runs`
    with source, the name of the side; `along` every evaluation, or at their ends. `frames` are those of
    `frames_together`, if they are known.
    """
    sides = [(side.name, side.frames) for side in (mine, *baselines) if side.frames is not None]
    frames = frames_together(mine, baselines) if frames is None else frames
    steps = sorted(frames.evaluations["step"].unique())
    runs = result_runs(frames, evaluations_at(frames, steps) if along else run_measures(frames))
    sources = {run_id: name for name, each in reversed(sides) for run_id in each.cells["run_id"]}
    runs = runs.assign(source=runs["run_id"].map(sources))
    own = (runs["source"] == mine.name).to_numpy(bool)
    wanted = _among(runs, runs[own], COMPARED) & ~_among(runs, runs[own], POOLED)
    return runs[own | wanted].reset_index(drop=True)


def new_teachers(mine: Side) -> list[str]:
    """Return the teachers that are compared: those the benchmark does not know, else all but Random."""
    teachers = [teacher for teacher in mine.table["teacher"].unique() if not is_baseline(teacher)]
    return [teacher for teacher in teachers if teacher not in TEACHERS] or teachers


def duels(runs: pd.DataFrame, teachers: Sequence[str], measure: str = HEADLINE) -> pd.DataFrame:
    """Return the test of each of `teachers` against every other one, challenge by challenge.

    Returns:
        Of `frame.pairwise`, with the teacher that is looked at first, and `frame.CORRECTED` for all that it
        is tested against on a challenge.
    """
    both = from_both_sides(pairwise(runs, measure, detectable=False))
    both = both[both["first"].isin(teachers)].reset_index(drop=True)
    return corrected(both, [*COMPARED, "first"])


def incomparable(mine: Side, baselines: Sequence[Side], runs: pd.DataFrame) -> list[str]:
    """Return a sentence on each baseline without comparable `runs`: why, and what to run."""
    said = []
    for side in baselines if len(mine.table) else ():
        if side.name in set(runs["source"]):
            continue
        if side.runs is None:
            reason = (
                f"its tables are of {side.engine}, and are set beside, untested; a release of runs, as "
                f"--baseline lite-1, is compared."
            )
        elif not _among(side.table, mine.table, COMPARED).any():
            reason = _apart(mine, side)
        else:
            continue
        said.append(f"Nothing of {side.name} may be compared with yours: {reason}")
    return said


def _apart(mine: Side, baseline: Side) -> str:
    """Return the conditions that a baseline shares with no result of mine, and a command to repeat them."""
    differing = []
    for column in dict.fromkeys(["challenge", "expert_knowledge", *CONDITION_LABELS]):
        name = CONDITION_LABELS.get(column, "expert knowledge")
        words_of = amount if column == "steps" else str
        ours, theirs = (dict.fromkeys(map(words_of, side.table[column])) for side in (mine, baseline))
        if not set(ours) & set(theirs):
            differing.append(f"{name} {listed(theirs)}, yours {listed(ours)}")
    reasons = "; ".join(differing) or "no result has all of its conditions in common with one of yours"
    repeat = f"tma-ray campaign --like {baseline.name} --teachers MODULE:NAME"
    if set(baseline.table["engine"]) == {SIMULATED}:
        repeat = "tma-ray simulate --teachers MODULE:NAME --results ROOT"
    return f"{reasons}. For results that may: {repeat}"


def beside(mine: Side, baseline: Side) -> pd.DataFrame:
    """Return the results of a baseline that are incomparable with mine, on challenges with results of mine.

    Returns:
        `CHALLENGE_LEVEL`, teacher, n, mastered_percent_mean and _std, and differs: what is not the same.
    """
    theirs = baseline.table[_among(_plain_places(baseline.table), _plain_places(mine.table), CHALLENGE_LEVEL)]
    if baseline.runs is not None:
        theirs = theirs[~_among(theirs, mine.table, COMPARED)]
    differs = [_differences(row, mine, baseline) for _, row in theirs.iterrows()]
    columns = [*CHALLENGE_LEVEL, "teacher", "n", f"{PAPERS}_mean", f"{PAPERS}_std"]
    return theirs[columns].assign(differs=differs).reset_index(drop=True)


def _among(frame: pd.DataFrame, others: pd.DataFrame, columns: list[str]) -> NDArray[np.bool_]:
    """Return a mask of the rows of `frame` that agree with any of `others` in all of `columns`."""
    if frame.empty or others.empty:
        return np.zeros(len(frame), dtype=bool)
    known = pd.MultiIndex.from_frame(others[columns])
    return np.asarray(pd.MultiIndex.from_frame(frame[columns]).isin(known))


def _plain_places(table: pd.DataFrame) -> pd.DataFrame:
    names = {name: table[name].map(base_name) for name in ("environment", "challenge")}
    return table.assign(**names)


def _differences(row: pd.Series, mine: Side, baseline: Side) -> str:
    place = [base_name(row["environment"]), base_name(row["challenge"]), row["expert_knowledge"]]
    here = mine.table[(_plain_places(mine.table)[CHALLENGE_LEVEL] == place).all(axis=1)]
    if baseline.runs is None:
        found = [f"engine {baseline.engine}"]
        if set(here["steps"]) != {row["steps"]}:
            found.append(f"{amount(row['steps'])} steps")
        students = {student for pool in here["pool"] for _, student in parts_of(pool)}
        if students != set(row["students"]):
            found.append(f"students {', '.join(row['students'])}")
        return "; ".join(found)
    return "; ".join(
        f"{words}: {amount(row[column]) if column == 'steps' else row[column]}"
        for column, words in CONDITION_LABELS.items()
        if row[column] not in set(here[column])
    )


def missing(mine: Side, teachers: Sequence[str]) -> list[str]:
    """Return the challenges of the benchmark on which `teachers` have no result at any level, in words."""
    had = mine.table[mine.table["n"] > 0]
    places = dict.fromkeys((matrix.environment, matrix.challenge) for matrix in MATRICES)
    said = []
    for teacher in teachers:
        own = had[had["teacher"] == teacher]
        done = set(own[["environment", "challenge"]].itertuples(index=False, name=None))
        absent = ", ".join(" ".join(place) for place in places if place not in done)
        said += [f"{label(teacher)}: {absent}"] if absent else []
    return said
