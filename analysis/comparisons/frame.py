"""Tests between teachers: of all pairs or against Random, at the end of training and along it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import pandas as pd

from analysis.data.frames import COMPARISON, GROUP
from analysis.data.identity import CONDITIONS
from analysis.data.reference import NO_BASELINE, baseline_rows, baseline_runs, is_baseline
from analysis.data.tables import check_columns, check_measure
from analysis.measures.pooling import COMPARED, PARTS
from analysis.measures.tested import Seeds, compared, scale_of, seeds_to_pair
from analysis.statistics import Comparison, Description, Method, Scale, describe, holm, welch_from_statistics
from analysis.statistics.power import detectable_difference, detectable_in_pairs
from tma_ray.arguments import check_known, check_names
from tma_ray.benchmark import TEACHERS

OTHER_PARTS = "other bodies or students"
"""Why two groups were not tested whose runs are not of the same bodies and students."""

OWN = ["measure", "first", "second", *Comparison.__dataclass_fields__, "uncounted", "detectable"]
"""Columns of `pairwise` besides those that groups have in common, and holm."""


def pairwise(
    runs: pd.DataFrame,
    measure: str,
    reference: str | None = None,
    within: Sequence[str] = COMPARED,
    between: str = "teacher",
    *,
    detectable: bool = True,
) -> pd.DataFrame:
    """Returns the tests between groups of runs, one row a pair.

    Welch's, or paired by seed where seeds share a student, on the scale of `tested.scale_of`. Runs without
    the measure do not count. Groups are not tested that share a run or that pool other bodies or students.

    Args:
        runs: rows of `pooling.pool_runs`; with a step column among `within`, the values of
            `run_measures.evaluations_at`, and so tests along learning curves.
        measure: column of `runs`.
        reference: the group that all others are tested against, such as "random"; None for all pairs.
        within: columns that groups must have in common to be compared.
        between: column that tells groups apart: teacher, or expert_knowledge (with teacher among `within`).
        detectable: whether that is computed, which takes longer than the tests.

    Returns:
        `within`, measure, first, second (the reference, if there is one), the columns of
        `statistics.Comparison` for first minus second, and

        - uncounted: runs of both without the measure, or not yet at the step; while there are any, the
          test is not the last word;
        - detectable: smallest difference that so many runs with these standard deviations find with power
          0.8; NaN without a test, or if it is not computed;
        - holm: p adjusted for all tests that have `within` in common, step left out, so that all pairs and
          steps of a comparison are one family.
    """
    _check(runs, measure, reference, within, between)
    within, rows = list(within), []
    parts = [column for column in PARTS if column not in (*within, between)]
    family, seeds = [column for column in within if column != "step"], seeds_to_pair(runs)
    for key, group in _groups(_counted(runs, [*family, between]), within):
        shared = dict(zip(within, key, strict=True)) | {"measure": measure}
        named = group.groupby(between, sort=True)
        samples = {str(name): _sample(part, measure, parts) for name, part in named}
        for first, second in pairs_of(list(samples), reference):
            other = samples.get(second) or _sample(group.head(0), measure, parts)
            row = shared | {"first": first, "second": second}
            row |= _compared(samples[first], other, seeds, scale_of(measure), detectable=detectable)
            rows.append(row if second in samples else row | {"reason": nobody(second)})
    table = pd.DataFrame(rows, columns=[*within, *OWN])
    table["holm"] = table.groupby(family, dropna=False)["p"].transform(holm) if len(table) else table["p"]
    return table


def _counted(runs: pd.DataFrame, keys: list[str]) -> pd.DataFrame:
    """Returns `runs` with the number of runs that have these columns in common."""
    return runs.assign(members=runs.groupby(keys, dropna=False)["run_id"].transform("nunique"))


def _groups(runs: pd.DataFrame, within: list[str]) -> Iterator[tuple[tuple[object, ...], pd.DataFrame]]:
    runs = runs[runs["step"].notna()] if "step" in within else runs
    yield from runs.groupby(within, dropna=False, sort=True)


def pairs_of(names: Sequence[str], reference: str | None) -> Iterator[tuple[str, str]]:
    """Yields each name with `reference`, or all pairs if there is none."""
    if reference is None:
        yield from itertools.combinations(names, 2)
    else:
        yield from ((name, reference) for name in names if name != reference)


@dataclass(frozen=True, eq=False)
class _Sample:
    """A group of runs: its values by run id, its bodies and students, and how many runs have no value."""

    values: pd.Series
    parts: frozenset[tuple[object, ...]]
    uncounted: int


def _sample(rows: pd.DataFrame, measure: str, parts: Sequence[str]) -> _Sample:
    rows = rows.drop_duplicates("run_id")
    there = rows[measure].notna().to_numpy()
    values = pd.Series(rows[measure].to_numpy(float)[there], index=rows["run_id"].to_numpy(object)[there])
    columns = [rows[column].to_numpy(object)[there] for column in parts]
    uncounted = int(rows["members"].max()) - len(values) if len(rows) else 0
    return _Sample(values, frozenset(zip(*columns, strict=True)), uncounted)


def _compared(
    first: _Sample, second: _Sample, seeds: Seeds, scale: Scale, *, detectable: bool
) -> dict[str, object]:
    """Returns the test of two groups, what it left out, and the difference that it could find."""
    comparison = compared(first.values, second.values, seeds, scale)
    if not comparison.reason and first.parts != second.parts:
        sizes = len(first.values), len(second.values)
        comparison = Comparison(*sizes, comparison.difference, reason=OTHER_PARTS)
    smallest = _detectable(comparison, first, second) if detectable else math.nan
    uncounted = first.uncounted + second.uncounted
    return vars(comparison) | {"uncounted": uncounted, "detectable": smallest}


def _detectable(comparison: Comparison, first: _Sample, second: _Sample) -> float:
    if comparison.reason or comparison.method is Method.SIGN_FLIP:
        return math.nan
    if comparison.method is Method.PAIRED:
        return detectable_in_pairs(comparison.n, (comparison.high - comparison.low) / 2)
    return detectable_difference(describe(first.values), describe(second.values))


def check_reference(reference: str | None, table: pd.DataFrame) -> None:
    """Refuses a reference that is neither a teacher of the table, nor one of the benchmark's.

    Raises:
        ValueError: the message holds the nearest teacher.
    """
    if reference is not None and len(table) and not is_baseline(reference):
        check_known("teacher", reference, {*table["teacher"].astype(str), *TEACHERS}, "there are")


def _check(
    runs: pd.DataFrame, measure: str, reference: str | None, within: Sequence[str], between: str
) -> None:
    check_names("within", within)
    check_measure("runs", runs, measure, [*within, between])
    if between == "teacher":
        check_reference(reference, runs)


def nobody(reference: str) -> str:
    """Returns why nothing was compared with `reference`, which was not run."""
    return NO_BASELINE if is_baseline(reference) else f"no {reference} to compare with"


APART = ("experiment", "expert_knowledge")
"""Columns that tell comparisons apart and make no difference to Random."""

ALIKE = [*(column for column in COMPARISON if column not in APART), *CONDITIONS]
"""Columns that Random must have in common with those that are tested against it."""

Randoms: TypeAlias = Mapping[Any, pd.DataFrame]


def against_baseline(finals: pd.DataFrame, curves: pd.DataFrame, measure: str) -> pd.DataFrame:
    """Returns the test of every teacher against Random, one row each, p and Holm's p by comparison.

    Where Random was run at another level of expert knowledge or in another experiment only, that one serves.
    While runs are under way both are read at the same step, and the difference is not tested.

    Args:
        finals: what `final_evaluations` returned.
        curves: what `evaluation_curves` returned.
        measure: column of both.
    """
    rows, randoms = [], randoms_of(finals)
    for key, teachers in finals.groupby(COMPARISON, sort=True):
        reference = reference_of(teachers, randoms)
        for name, mine in teachers.groupby("teacher", sort=True):
            teacher = str(name)
            if not is_baseline(teacher):
                step, comparison = _at_one_step(mine, reference, curves, measure)
                names = dict(zip(COMPARISON, key, strict=True)) | {"teacher": teacher}
                rows.append(names | {"measure": measure, "step": step} | vars(comparison))
    table = pd.DataFrame(rows, columns=[*GROUP, "measure", "step", *Comparison.__dataclass_fields__])
    table["holm"] = table.groupby(COMPARISON)["p"].transform(holm)
    return table


def along_baseline(curves: pd.DataFrame, reference: pd.DataFrame, measure: str) -> pd.DataFrame:
    """Returns the test of every teacher against Random at every evaluation, with Holm's p by step.

    Args:
        curves: of `evaluation_curves`, of one comparison.
        reference: Random's rows of them, of `reference_of`.
        measure: column of both.

    Returns:
        step, teacher, the columns of `statistics.Comparison`, and holm.
    """
    theirs: dict[Any, pd.Series] = {step: _by_run(rows, measure) for step, rows in reference.groupby("step")}
    mine = curves[~curves["teacher"].map(is_baseline)]
    rows, seeds = [], seeds_to_pair(curves, reference)
    for (step, teacher), group in mine.groupby(["step", "teacher"], sort=True):
        sample = _by_run(group, measure)
        comparison = Comparison(int(sample.notna().sum()), 0, math.nan, reason=NO_BASELINE)
        if step in theirs:
            comparison = compared(sample, theirs[step], seeds, scale_of(measure))
        rows.append({"step": step, "teacher": teacher} | vars(comparison))
    table = pd.DataFrame(rows, columns=["step", "teacher", *Comparison.__dataclass_fields__])
    table["holm"] = table.groupby("step")["p"].transform(holm)
    return table


def _by_run(rows: pd.DataFrame, measure: str) -> pd.Series:
    return pd.Series(rows[measure].to_numpy(float), index=rows["run_id"].to_numpy(object))


def _at_one_step(
    mine: pd.DataFrame, reference: pd.DataFrame, curves: pd.DataFrame, measure: str
) -> tuple[float, Comparison]:
    """Returns the step at which two groups are compared, and the comparison."""
    step, reason = min(mine["step"].max(), reference["step"].max()), ""
    if reference.empty:
        reason = NO_BASELINE
    elif mine["provisional"].any() or reference["provisional"].any():
        reason = "still running"
        now = curves[curves["step"] == step].drop_duplicates("run_id")
        mine, reference = (now[now["run_id"].isin(rows["run_id"])] for rows in (mine, reference))
    elif set(mine["step"]) != set(reference["step"]):
        reason = "trained for other numbers of steps"
    seeds = seeds_to_pair(mine, reference)
    comparison = compared(_by_run(mine, measure), _by_run(reference, measure), seeds, scale_of(measure))
    if reason:
        comparison = Comparison(comparison.n, comparison.reference_n, comparison.difference, reason=reason)
    return step, comparison


def randoms_of(everything: pd.DataFrame) -> Randoms:
    """Returns the rows of Random by the columns `ALIKE`, of rows with `GROUP` and `CONDITIONS`."""
    return dict(list(baseline_rows(everything).groupby(ALIKE))) if len(everything) else {}


def reference_of(teachers: pd.DataFrame, randoms: Randoms) -> pd.DataFrame:
    """Returns the rows of Random that the rows of one experiment are tested against, by `baseline_runs`.

    Args:
        teachers: rows of one comparison, at least one, with `GROUP` and the columns of `CONDITIONS`.
        randoms: of `randoms_of` of the root.
    """
    alike = randoms.get(tuple(teachers[ALIKE].iloc[0]), teachers.head(0))
    return baseline_runs(teachers, alike, APART).drop_duplicates(["run_id", "step"])


WITHIN = [*COMPARED, "embodiments", "students"]
"""Columns that teachers must have in common to be compared, of those that a table has."""


def pairwise_from_statistics(
    table: pd.DataFrame,
    measure: str = "mastered_percent",
    reference: str | None = None,
    within: Sequence[str] = WITHIN,
) -> pd.DataFrame:
    """Returns Welch's t-test between teachers, one row a pair, as `pairwise.pairwise` does from runs.

    For published tables. Of our own results prefer the runs, which also tell whether two samples share some.

    Args:
        table: one row per teacher: teacher, n, `measure` with the endings _mean and _std, and those of
            `within` that there are.
        measure: what is compared.
        reference: the teacher that all others are tested against; None for all pairs.
        within: columns that teachers must have in common to be compared; absent ones do not matter.

    Returns:
        `within`, measure, first, second, the columns of `statistics.Comparison` for first minus second, and
        holm: p adjusted for all tests that have `within` in common.
    """
    check_columns("table", table, ["teacher", "n", f"{measure}_mean", f"{measure}_std"])
    check_reference(reference, table)
    within, rows = [column for column in within if column in table], []
    for key, group in table.groupby(within, dropna=False, sort=True) if within else [((), table)]:
        results = {
            str(teacher): Description(int(n), float(mean), float(std))
            for teacher, n, mean, std in group[
                ["teacher", "n", f"{measure}_mean", f"{measure}_std"]
            ].itertuples(index=False, name=None)
        }
        shared = dict(zip(within, key, strict=True)) | {"measure": measure}
        for first, second in pairs_of(sorted(results), reference):
            names = {"first": first, "second": second}
            rows.append(
                shared | names | vars(_compared_descriptions(results[first], results.get(second), second))
            )
    columns = [*within, "measure", "first", "second", *Comparison.__dataclass_fields__]
    tests = pd.DataFrame(rows, columns=columns)
    families = tests.groupby(within, dropna=False)["p"] if within and len(tests) else None
    tests["holm"] = holm(tests["p"]) if families is None else families.transform(holm)
    return tests


def _compared_descriptions(first: Description, second: Description | None, name: str) -> Comparison:
    if second is None:
        return Comparison(first.n, 0, float("nan"), reason=nobody(name))
    return welch_from_statistics(first, second)
