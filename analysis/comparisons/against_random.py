"""Tests of every teacher of an experiment against Random."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, TypeAlias

import pandas as pd

from analysis.data.frames import COMPARISON, GROUP
from analysis.data.identity import CONDITIONS
from analysis.data.reference import NO_BASELINE, baseline_rows, baseline_runs, is_baseline
from analysis.measures.shared_students import compared, seeds_to_pair
from analysis.measures.tested import scale_of
from analysis.statistics import Comparison, holm

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
                step, comparison = _compare(mine, reference, curves, measure)
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
    theirs: dict[Any, pd.Series] = {step: _sample(rows, measure) for step, rows in reference.groupby("step")}
    mine = curves[~curves["teacher"].map(is_baseline)]
    rows, seeds = [], seeds_to_pair(curves, reference)
    for (step, teacher), group in mine.groupby(["step", "teacher"], sort=True):
        sample = _sample(group, measure)
        comparison = Comparison(int(sample.notna().sum()), 0, math.nan, reason=NO_BASELINE)
        if step in theirs:
            comparison = compared(sample, theirs[step], seeds, scale_of(measure))
        rows.append({"step": step, "teacher": teacher} | vars(comparison))
    table = pd.DataFrame(rows, columns=["step", "teacher", *Comparison.__dataclass_fields__])
    table["holm"] = table.groupby("step")["p"].transform(holm)
    return table


def _sample(rows: pd.DataFrame, measure: str) -> pd.Series:
    return pd.Series(rows[measure].to_numpy(float), index=rows["run_id"].to_numpy(object))


def _compare(
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
    comparison = compared(_sample(mine, measure), _sample(reference, measure), seeds, scale_of(measure))
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
