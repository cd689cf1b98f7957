"""The table of one comparison: a row for each teacher, at the ends of runs and at every evaluation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from analysis.comparisons.against_random import along_baseline, reference_of
from analysis.comparisons.findings import MASTERED, verdict
from analysis.comparisons.measured import Measured
from analysis.data.reference import is_baseline
from analysis.formatting import amount, ends, number, p_value, plus_minus
from analysis.looks import look
from analysis.names import label, teacher_order
from analysis.statistics import describe

NONE = {"difference": "", "p": ""}


def end_rows(mine: Measured) -> list[dict[str, Any]]:
    """Returns the rows of the table at the ends of runs, Random first."""
    tests = mine.tests[mine.tests["measure"] == MASTERED.column]
    rows = []
    for teacher in sorted(mine.summary["teacher"], key=teacher_order):
        group = mine.summary[mine.summary["teacher"] == teacher].iloc[0]
        test = tests[tests["teacher"] == teacher]
        against = _against_random(test.iloc[0]) if len(test) else NONE
        untested = "baseline" if is_baseline(teacher) else "not evaluated yet"
        worst = mine.finals.loc[mine.finals["teacher"] == teacher, "mastered_percent"].min()
        rows.append({"verdict": untested, "worst": number(worst)} | _end_row(teacher, group) | against)
    return rows


def step_rows(mine: Measured, everything: Measured) -> dict[str, dict[str, dict[str, str]]]:
    """Returns what changes of the rows at every evaluation, as text by step, teacher and column.

    Args:
        mine: what was measured of the comparison.
        everything: of the root, where Random may have run at another level or in another experiment.
    """
    curves = mine.evaluations
    if curves.empty:
        return {}
    reference = reference_of(curves, everything.randoms)
    tests = along_baseline(curves, reference, MASTERED.column).set_index(["step", "teacher"])
    tested: dict[Any, Any] = tests.to_dict("index")
    found: dict[str, dict[str, dict[str, str]]] = {}
    key: Any
    for key, rows in curves.groupby(["step", "teacher"], sort=True):
        step, teacher = int(key[0]), str(key[1])
        row = _step_row(step, rows) | ({"verdict": "baseline"} if is_baseline(teacher) else {})
        test = tested.get((step, teacher))
        found.setdefault(str(step), {})[teacher] = row | (_against_random(test) if test else NONE)
    return found


def _end_row(teacher: str, group: pd.Series) -> dict[str, Any]:
    return {
        "name": teacher,
        "teacher": label(teacher),
        "colour": look(teacher).colour,
        "seeds": f"{group['n']}" if group["n"] == group["seeds"] else f"{group['n']} of {group['seeds']}",
        "step": (amount(group["step"]) if group["n"] else "\N{EN DASH}") + "*" * bool(group["provisional"]),
        "mastered": plus_minus(group["mastered_percent_mean"], group["mastered_percent_std"]),
        "evaluation": plus_minus(group["evaluation_return_mean"], group["evaluation_return_std"]),
        "training": f"{number(group['first_quarter_mean'])} → {number(group['last_quarter_mean'])}",
        "provisional": group["provisional"],
    }


def _step_row(step: int, rows: pd.DataFrame) -> dict[str, str]:
    mastered, returns = (describe(rows[column]) for column in ("mastered_percent", "evaluation_return"))
    return {
        "seeds": str(rows["run_id"].nunique()),
        "step": amount(step),
        "mastered": plus_minus(mastered.mean, mastered.std),
        "worst": number(rows["mastered_percent"].min()),
        "evaluation": plus_minus(returns.mean, returns.std),
        "training": "",
        "verdict": "",
    }


def _against_random(test: Mapping[str, Any]) -> dict[str, str]:
    difference = number(test["difference"])
    if test["reason"]:
        return {"verdict": verdict(test), "difference": difference, "p": ""}
    return {
        "verdict": verdict(test),
        "difference": f"{difference} {ends(test['low'], test['high'])}",
        "p": p_value(test["holm"]).removeprefix("p").removeprefix(" = ").strip(),
    }
