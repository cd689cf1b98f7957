"""Welch's test of every teacher of an experiment against Random."""

from __future__ import annotations

import pandas as pd

from analysis.data.frames import COMPARISON, GROUP
from analysis.data.identity import CONDITIONS
from analysis.data.reference import NO_BASELINE, baseline_runs, is_baseline
from analysis.statistics import Comparison, holm, welch

APART = ("experiment", "expert_knowledge")
"""Columns that tell comparisons apart and make no difference to Random."""

ALIKE = [*(column for column in COMPARISON if column not in APART), *CONDITIONS]
"""Columns that Random must have in common with those that are tested against it."""


def against_baseline(finals: pd.DataFrame, curves: pd.DataFrame, measure: str) -> pd.DataFrame:
    """Returns Welch's t-test of every teacher against Random, one row each, p and Holm's p by comparison.

    Where Random was run at another level of expert knowledge or in another experiment only, that one serves.
    While runs are under way both are read at the same step, and the difference is not tested.

    Args:
        finals: what `final_evaluations` returned.
        curves: what `evaluation_curves` returned.
        measure: column of both.
    """
    rows = []
    for key, teachers in finals.groupby(COMPARISON, sort=True):
        reference = reference_of(teachers, finals)
        for teacher in sorted(set(teachers["teacher"])):
            mine = teachers[teachers["teacher"] == teacher]
            if not is_baseline(teacher):
                step, comparison = _compare(mine, reference, curves, measure)
                names = dict(zip(COMPARISON, key, strict=True)) | {"teacher": teacher}
                rows.append(names | {"measure": measure, "step": step} | vars(comparison))
    table = pd.DataFrame(rows, columns=[*GROUP, "measure", "step", *Comparison.__dataclass_fields__])
    table["holm"] = table.groupby(COMPARISON)["p"].transform(holm)
    return table


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
    comparison = welch(*(rows.set_index("run_id")[measure] for rows in (mine, reference)))
    if reason:
        comparison = Comparison(comparison.n, comparison.reference_n, comparison.difference, reason=reason)
    return step, comparison


def reference_of(teachers: pd.DataFrame, everything: pd.DataFrame) -> pd.DataFrame:
    """Returns the rows of Random that the rows of one experiment are tested against, by `baseline_runs`.

    Args:
        teachers: rows of one comparison, at least one, with `GROUP` and the columns of `CONDITIONS`.
        everything: rows of the root with the same columns.
    """
    alike = (everything[ALIKE] == teachers[ALIKE].iloc[0]).all(axis=1)
    return baseline_runs(teachers, everything[alike], APART).drop_duplicates(["run_id", "step"])
