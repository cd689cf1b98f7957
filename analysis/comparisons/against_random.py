"""Welch's test of every teacher of an experiment against Random."""

from __future__ import annotations

import pandas as pd

from analysis.data.frames import COMPARISON, GROUP
from analysis.data.reference import NO_BASELINE, is_baseline
from analysis.statistics import Comparison, holm, welch


def against_baseline(finals: pd.DataFrame, curves: pd.DataFrame, measure: str) -> pd.DataFrame:
    """Returns Welch's t-test of every teacher against Random, one row each, p and Holm's p by comparison.

    Where Random was run at another level of expert knowledge only, that one serves: it uses none.
    While runs are under way both are read at the same step, and the difference is not tested.

    Args:
        finals: what `final_evaluations` returned.
        curves: what `evaluation_curves` returned.
        measure: column of both.
    """
    rows = []
    for key, teachers in finals.groupby(COMPARISON, sort=True):
        reference = _reference(finals, teachers)
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


def _reference(finals: pd.DataFrame, teachers: pd.DataFrame) -> pd.DataFrame:
    """Returns Random's final evaluations for one comparison, from another knowledge level if need be."""
    own = teachers[teachers["teacher"].map(is_baseline)]
    if len(own):
        return own
    columns = [column for column in COMPARISON if column != "expert_knowledge"]
    same = (finals[columns] == teachers[columns].iloc[0]).all(axis=1)
    return finals[same & finals["teacher"].map(is_baseline)].drop_duplicates("run_id")
