"""Results of several sources: comparable runs, their tests, and results that are not comparable."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.baselines.catalogue import BaselineKind, as_baseline, read
from analysis.comparisons.pairwise import corrected, from_both_sides, pairwise
from analysis.data.columns import CHALLENGE_LEVEL, COMPARED, CONDITION_LABELS, NAMED, POOLED
from analysis.data.frames import Frames
from analysis.data.loading import joined
from analysis.data.naming import disambiguate_names
from analysis.data.reference import is_baseline
from analysis.formatting import listed, steps_text
from analysis.measures.pooling import parts_of, pooled, result_runs
from analysis.measures.run_measures import evaluations_at, run_measures
from analysis.measures.tested import HEADLINE, PAPERS
from analysis.names import label
from tma_ray.benchmark import MATRICES, TEACHERS
from tma_ray.results import CHIPMUNK, SIMULATED
from tma_ray.support.component_names import base_name


@dataclass(frozen=True)
class ResultSet:
    """Results of one source, a results root or a baseline."""

    name: str  # name on pages
    engine: str  # physics engines of the results, with their versions if they have any
    table: pd.DataFrame  # results from `pooling.pooled`, or from `reference.paper_frame`
    runs: pd.DataFrame | None = None  # rows from `pooling.pool_runs`; None for published tables
    frames: Frames | None = None  # results of the root; None for published tables


def result_set(frames: Frames, name: str) -> ResultSet:
    """Return the final results of the runs of a root or a release."""
    runs, engines = result_runs(frames, run_measures(frames)), []
    for engine in sorted(map(str, runs["engine"].unique())):
        rows = runs[runs["engine"] == engine]
        versions = ", ".join(f"{version:g}" for version in sorted(rows["physics_version"].dropna().unique()))
        engines.append(f"{engine}, physics version {versions}" if engine == CHIPMUNK else engine)
    return ResultSet(name, "; ".join(engines), pooled(runs, [PAPERS]), runs, frames)


def named_jointly(
    yours: ResultSet, baselines: Sequence[ResultSet]
) -> tuple[ResultSet, list[ResultSet], tuple[str, ...]]:
    """Make names unambiguous across all result sets, and return these and a sentence about each new name.

    A name such as PPO may stand for other settings, or another version, in another root.
    """
    sources = [yours, *baselines]
    frames = {index: source.frames for index, source in enumerate(sources) if source.frames is not None}
    named, sentences = disambiguate_names([root.cells for root in frames.values()])
    for (index, root), cells in zip(frames.items(), named, strict=True):
        if not cells[NAMED].equals(root.cells[NAMED]):
            sources[index] = result_set(replace(root, cells=cells), sources[index].name)
    return sources[0], sources[1:], sentences


def baseline_results(name_or_root: str) -> ResultSet:
    """Return the results of a baseline or a root, given by name, folder or address.

    Of published tables, only results that pool all runs of the table on a challenge count.

    Raises:
        BaselineError: if the baseline is damaged.
        ResultsRootError: if it is none of these.
    """
    baseline = as_baseline(name_or_root)
    name = Path(name_or_root).name if baseline is None else baseline.manifest.name
    if baseline is None or baseline.manifest.kind is BaselineKind.RUNS:
        return result_set(read(name_or_root), name)
    table = baseline.published()
    whole = table.groupby(CHALLENGE_LEVEL)["n"].transform("max") == table["n"]
    return ResultSet(name, ", ".join(sorted(table["engine"].unique())), table[whole].reset_index(drop=True))


def joined_frames(yours: ResultSet, baselines: Sequence[ResultSet]) -> Frames:
    """Return the results of all sources with runs, joined as if from one root."""
    return joined([source.frames for source in (yours, *baselines) if source.frames is not None])


def comparable_runs(
    yours: ResultSet, baselines: Sequence[ResultSet], frames: Frames | None = None, *, along: bool = False
) -> pd.DataFrame:
    """Return your runs, and those of baselines that were made under the same conditions.

    Your runs of a teacher replace those of baselines under the same conditions. Random uses no expert
    knowledge, so runs of it count at every level.

    Args:
        yours: results of the reader.
        baselines: other results.
        frames: results from `joined_frames`, if they have been joined.
        along: True for every evaluation instead of the ends of runs.

    Returns:
        Rows of `pooling.pool_runs` with source, the name of the results.
    """
    sources = [(source.name, source.frames) for source in (yours, *baselines) if source.frames is not None]
    frames = joined_frames(yours, baselines) if frames is None else frames
    steps = sorted(frames.evaluations["step"].unique())
    runs = result_runs(frames, evaluations_at(frames, steps) if along else run_measures(frames))
    names = {run_id: name for name, root in reversed(sources) for run_id in root.cells["run_id"]}
    runs = runs.assign(source=runs["run_id"].map(names))
    is_yours = (runs["source"] == yours.name).to_numpy(bool)
    added = _among(runs, runs[is_yours], COMPARED) & ~_among(runs, runs[is_yours], POOLED)
    return runs[is_yours | added].reset_index(drop=True)


def new_teachers(yours: ResultSet) -> list[str]:
    """Return those of your teachers that are not in the benchmark, or all but Random if there are none."""
    teachers = [teacher for teacher in yours.table["teacher"].unique() if not is_baseline(teacher)]
    return [teacher for teacher in teachers if teacher not in TEACHERS] or teachers


def head_to_head(runs: pd.DataFrame, teachers: Sequence[str], measure: str = HEADLINE) -> pd.DataFrame:
    """Return the tests of each of `teachers` against every other teacher, challenge by challenge.

    Returns:
        Rows of `pairwise.pairwise` with one of `teachers` first, and `pairwise.CORRECTED` for all of its
        tests on a challenge.
    """
    both = from_both_sides(pairwise(runs, measure, detectable=False))
    both = both[both["first"].isin(teachers)].reset_index(drop=True)
    return corrected(both, [*COMPARED, "first"])


def incomparable(yours: ResultSet, baselines: Sequence[ResultSet], runs: pd.DataFrame) -> list[str]:
    """Return a sentence about each baseline that has none of `runs`: the reason, and what to run instead."""
    sentences = []
    for baseline in baselines if len(yours.table) else ():
        if baseline.name in set(runs["source"]):
            continue
        if baseline.runs is None:
            reason = (
                f"its tables are of {baseline.engine}, and are set beside, untested; a release of runs, as "
                f"--baseline lite-1, is compared."
            )
        elif not _among(baseline.table, yours.table, COMPARED).any():
            reason = _differing_conditions(yours, baseline)
        else:
            continue
        sentences.append(f"Nothing of {baseline.name} may be compared with yours: {reason}")
    return sentences


def _differing_conditions(yours: ResultSet, baseline: ResultSet) -> str:
    """Return a baseline's conditions that none of your results share, and a command for runs under them."""
    differing = []
    for column in dict.fromkeys(["challenge", "expert_knowledge", *CONDITION_LABELS]):
        name = CONDITION_LABELS.get(column, "expert knowledge")
        text_of: Callable[[Any], str] = steps_text if column == "steps" else str
        values, others = (dict.fromkeys(map(text_of, results.table[column])) for results in (yours, baseline))
        if not set(values) & set(others):
            differing.append(f"{name} {listed(others)}, yours {listed(values)}")
    reasons = "; ".join(differing) or "no result has all of its conditions in common with one of yours"
    repeat = f"tma-ray campaign --like {baseline.name} --teachers MODULE:NAME"
    if set(baseline.table["engine"]) == {SIMULATED}:
        repeat = "tma-ray simulate --teachers MODULE:NAME --results ROOT"
    return f"{reasons}. For results that may: {repeat}"


def reference_only(yours: ResultSet, baseline: ResultSet) -> pd.DataFrame:
    """Return a baseline's results on your challenges that are not comparable with yours.

    Returns:
        `CHALLENGE_LEVEL`, teacher, n, mastered_percent_mean and _std, and differs, the differences as text.
    """
    places = _without_settings(yours.table)
    rows = baseline.table[_among(_without_settings(baseline.table), places, CHALLENGE_LEVEL)]
    if baseline.runs is not None:
        rows = rows[~_among(rows, yours.table, COMPARED)]
    differs = [
        _differences(row, yours.table[_same_challenge(places, row)], baseline) for _, row in rows.iterrows()
    ]
    columns = [*CHALLENGE_LEVEL, "teacher", "n", f"{PAPERS}_mean", f"{PAPERS}_std"]
    return rows[columns].assign(differs=differs).reset_index(drop=True)


def _among(table: pd.DataFrame, others: pd.DataFrame, columns: list[str]) -> NDArray[np.bool_]:
    """Return a mask of the rows of `table` whose values in `columns` equal those of any row of `others`."""
    if table.empty or others.empty:
        return np.zeros(len(table), dtype=bool)
    keys = pd.MultiIndex.from_frame(others[columns])
    return np.asarray(pd.MultiIndex.from_frame(table[columns]).isin(keys))


def _without_settings(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(**{name: table[name].map(base_name) for name in ("environment", "challenge")})


def _same_challenge(places: pd.DataFrame, row: pd.Series) -> pd.Series:
    """Return a mask of the rows of `places` at the challenge and level of `row`, ignoring settings."""
    key = [base_name(row["environment"]), base_name(row["challenge"]), row["expert_knowledge"]]
    return (places[CHALLENGE_LEVEL] == key).all(axis=1)


def _differences(row: pd.Series, yours: pd.DataFrame, baseline: ResultSet) -> str:
    """Return a phrase with the conditions in which a result of `baseline` differs from `yours`."""
    if baseline.runs is None:
        differences = [f"engine {baseline.engine}"]
        if set(yours["steps"]) != {row["steps"]}:
            differences.append(f"{steps_text(row['steps'])} steps")
        students = {student for pool in yours["pool"] for _, student in parts_of(pool)}
        if students != set(row["students"]):
            differences.append(f"students {', '.join(row['students'])}")
        return "; ".join(differences)
    return "; ".join(
        f"{name}: {steps_text(row[column]) if column == 'steps' else row[column]}"
        for column, name in CONDITION_LABELS.items()
        if row[column] not in set(yours[column])
    )


def missing_challenges(yours: ResultSet, teachers: Sequence[str]) -> list[str]:
    """Return a line for each teacher without results on all benchmark challenges, naming those it lacks."""
    results = yours.table[yours.table["n"] > 0]
    challenges = dict.fromkeys((matrix.environment, matrix.challenge) for matrix in MATRICES)
    sentences = []
    for teacher in teachers:
        rows = results[results["teacher"] == teacher]
        done = set(rows[["environment", "challenge"]].itertuples(index=False, name=None))
        absent = ", ".join(" ".join(challenge) for challenge in challenges if challenge not in done)
        sentences += [f"{label(teacher)}: {absent}"] if absent else []
    return sentences
