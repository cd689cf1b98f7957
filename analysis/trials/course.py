"""The course of a trial as charts show it: where it stands, and how far a verdict is; and its curves."""

from __future__ import annotations

import pandas as pd

from analysis.data.frames import Frames
from analysis.measures.evaluations import aggregate
from analysis.trials.design import PLACE, Design, Released, planned
from analysis.trials.standing import LARGEST, Look


def course(design: Design, released: Released, looks: list[Look], reference: str) -> pd.DataFrame:
    """Returns a row for each look of one comparison, those to come as the release lets expect them.

    Returns:
        seeds; better and worse: differences beyond which the teacher is; value, low and high: difference
        and repeated confidence interval, NaN of looks to come; verdict; in points.
    """
    runs = released.moments(reference, [cell.place for cell in design.cells]).runs
    rule = design.rule(reference, runs)
    rows = []
    for number, (seeds, expected) in enumerate(zip(design.looks, planned(design, runs), strict=True)):
        ends = {"better": float(rule.reach(expected, number, above=True))}
        ends["worse"] = -float(rule.reach(expected, number, above=False))
        row: dict[str, object] = {"seeds": seeds, "value": float("nan"), "low": float("nan")}
        row |= {"high": float("nan"), "verdict": ""}
        if number < len(looks):
            found = next(each for each in looks[number].findings if each.reference == reference)
            ends = {"better": found.value - found.low, "worse": found.value - found.high}
            row |= {"value": found.value, "low": found.low, "high": found.high}
            row["verdict"] = found.verdict.value
        rows.append(row | {name: max(-LARGEST, min(LARGEST, end)) for name, end in ends.items()})
    return pd.DataFrame(rows)


def curves(design: Design, frames: Frames, own: Frames) -> pd.DataFrame:
    """Returns the learning curves of the new teacher and of both references, over the cells of the trial.

    Returns:
        teacher, step, n, mean, std and standard_error of the mastered test tasks, in per cent.
    """
    places = pd.DataFrame([cell.place for cell in design.cells], columns=PLACE)
    found = []
    for source, names in ((frames, design.references), (own, (design.teacher,))):
        cells = source.cells[source.cells["teacher"].isin(names)].astype(dict.fromkeys(PLACE, str))
        runs = cells.merge(places, on=PLACE)[["teacher", "run_id"]].drop_duplicates()
        rows = source.measured[["run_id", "step", "mastered_percent"]].astype({"run_id": object})
        found.append(runs.astype(object).merge(rows, on="run_id"))
    return aggregate(pd.concat(found, ignore_index=True), "mastered_percent", ["teacher"])
