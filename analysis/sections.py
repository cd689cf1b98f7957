"""One comparison of teachers as a section of the report: sentences, a table, figures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import pandas as pd

from analysis.comparison import Measured
from analysis.findings import Measure, compared_by, findings, verdict
from analysis.formatting import amount, number, p_value, plus_minus
from analysis.frames import Frames
from analysis.measures import is_baseline
from analysis.picture import Picture
from analysis.pictures import pictures
from analysis.style import label, look, teacher_order
from tma_ray.benchmark import find_challenge


@dataclass(frozen=True)
class Section:
    """One comparison.

    Attributes:
        anchor: identifier on the page.
        title: what is compared.
        sentences: what was found.
        compared_by: measure of the comparison with Random.
        rows: cells of the table, one row per teacher.
        pictures: its figures.
    """

    anchor: str
    title: str
    sentences: list[str]
    compared_by: Measure
    rows: list[dict[str, Any]]
    pictures: list[Picture]


def sections(frames: Frames, measured: Measured) -> Iterator[Section]:
    """Yields a section for each comparison of the root, in a fixed order."""
    several = frames.cells["experiment"].nunique() > 1
    for count, mine in enumerate(measured.comparisons(), start=1):
        anchor = f"comparison-{count}"
        drawn = [replace(picture, name=f"{anchor}-{picture.name}") for picture in pictures(frames, mine)]
        yield Section(
            anchor=anchor,
            title=_title(mine.cells.iloc[0], several),
            sentences=findings(mine.summary, mine.tests),
            compared_by=compared_by(mine.summary),
            rows=_rows(mine),
            pictures=drawn,
        )


def _title(comparison: pd.Series, with_experiment: bool) -> str:
    """Returns what a comparison is about."""
    try:
        challenge = find_challenge(comparison["environment"], comparison["challenge"]).title
    except ValueError:  # somebody else's environment
        challenge = comparison["challenge"]
    parts = [
        comparison["environment"].replace("_", " ").capitalize(),
        challenge[:1].lower() + challenge[1:],
        comparison["embodiment"].replace("_", " "),
        comparison["student"].upper(),
        f"expert knowledge {comparison['expert_knowledge']}",
    ]
    if with_experiment:
        parts.insert(0, comparison["experiment"])
    return ", ".join(part for part in parts if part)


def _rows(mine: Measured) -> list[dict[str, Any]]:
    tests = mine.tests[mine.tests["measure"] == compared_by(mine.summary).column]
    rows = []
    for teacher in sorted(mine.summary["teacher"], key=teacher_order):
        group = mine.summary[mine.summary["teacher"] == teacher].iloc[0]
        test = tests[tests["teacher"] == teacher]
        against = _against_random(test.iloc[0]) if len(test) else {"difference": "", "p": ""}
        untested = "baseline" if is_baseline(teacher) else "not evaluated yet"
        rows.append({"verdict": untested} | _row(teacher, group) | against)
    return rows


def _row(teacher: str, group: pd.Series) -> dict[str, Any]:
    return {
        "teacher": label(teacher),
        "colour": look(teacher).colour,
        "seeds": f"{group['n']}" if group["n"] == group["seeds"] else f"{group['n']} of {group['seeds']}",
        "step": amount(group["step"]) if group["n"] else "\N{EN DASH}",
        "mastered": plus_minus(group["mastered_percent_mean"], group["mastered_percent_std"]),
        "evaluation": plus_minus(group["evaluation_return_mean"], group["evaluation_return_std"]),
        "training": f"{number(group['first_quarter_mean'])} → {number(group['last_quarter_mean'])}",
        "provisional": group["provisional"],
    }


def _against_random(test: pd.Series) -> dict[str, str]:
    difference = number(test["difference"])
    if test["reason"]:
        return {"verdict": verdict(test), "difference": difference, "p": ""}
    return {
        "verdict": verdict(test),
        "difference": f"{difference} [{number(test['low'])}, {number(test['high'])}]",
        "p": p_value(test["p"]).removeprefix("p").removeprefix(" = ").strip(),
    }
