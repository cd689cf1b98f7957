"""The standing of a trial: its comparisons at each look that is complete, and what charts show of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
import pandas as pd

from analysis.data.frames import Frames
from analysis.measures.evaluations import aggregate
from analysis.trials.boundaries import median_unbiased
from analysis.trials.design import PLACE, Design, Released, moments, planned
from analysis.trials.rules import FUTILE, Floats, Moments, Rule, Verdict, difference

LARGEST = 100.0
"""Largest difference that there can be, in points."""


class Ending(StrEnum):
    """Why a trial ends.

    Attributes:
        DECIDED: both comparisons have a verdict.
        FUTILE: no open comparison is likely to get one.
        LAST: all looks are done.
        GOES_ON: it does not end yet.
    """

    DECIDED = "decided"
    FUTILE = "futile"
    LAST = "last look"
    GOES_ON = ""


@dataclass(frozen=True)
class Finding:
    """A comparison at a look, in points.

    Attributes:
        reference: teacher that the new one is compared with.
        seeds: seeds of every cell of the new teacher.
        value: difference as seen.
        unbiased: median-unbiased estimate of it, which allows for the looks before; NaN after a verdict.
        low: lower end of the repeated confidence interval.
        high: upper end of it.
        verdict: verdict by that interval.
        power: probability that the last look would decide; 1 once it is decided.
        within_budget: probability that the last look within the budget would.
    """

    reference: str
    seeds: int
    value: float
    unbiased: float
    low: float
    high: float
    verdict: Verdict
    power: float
    within_budget: float


@dataclass(frozen=True)
class Look:
    """A look at a trial.

    Attributes:
        seeds: seeds of every cell.
        findings: comparisons as they are at this look.
        settled: comparisons as they were when they were decided, or else as they are.
        ending: reason why the trial ends here; None if it does not.
        excluded: runs left out, whose returns are not finite.
    """

    seeds: int
    findings: tuple[Finding, ...]
    settled: tuple[Finding, ...]
    ending: Ending
    excluded: int = 0


def looks_at(
    design: Design, released: Released, own: pd.DataFrame, affordable: int | None = None
) -> list[Look]:
    """Return the looks of a trial of which all runs have ended, none after one at which it ends.

    Args:
        design: fixed design of the trial.
        released: runs of the release.
        own: runs of the new teacher, of `design.ended_runs`.
        affordable: number of the last look within the budget, from 0 on; None for all.
    """
    affordable = len(design.looks) - 1 if affordable is None else affordable
    places = [cell.place for cell in design.cells]
    references = [released.moments(name, places) for name in design.references]
    rules = [design.rule(n, r.runs) for n, r in zip(design.references, references, strict=True)]
    found: list[Look] = []
    decided: dict[str, Finding] = {}
    past: list[Moments] = []
    for number, seeds in enumerate(design.looks):
        samples = _own(design, own, design.seeds[:seeds])
        if any(len(sample) < seeds for sample in samples):
            break
        finite = [sample[np.isfinite(sample)] for sample in samples]
        excluded = sum(map(len, samples)) - sum(map(len, finite))
        teacher = moments(finite)
        past.append(teacher)
        findings = tuple(
            _finding(name, rule, past, reference, design, number, affordable)
            for name, rule, reference in zip(design.references, rules, references, strict=True)
        )
        findings = tuple(
            replace(each, unbiased=math.nan) if each.reference in decided else each for each in findings
        )
        for each in findings:
            if each.verdict != Verdict.OPEN:
                decided.setdefault(each.reference, each)
        settled = tuple(decided.get(each.reference, each) for each in findings)
        found.append(Look(seeds, findings, settled, _ending(settled, number, design), excluded))
        if found[-1].ending:
            break
    return found


def _own(design: Design, own: pd.DataFrame, seeds: Sequence[int]) -> list[Floats]:
    """Return the arcsines of the new teacher's runs with `seeds` in each cell, NaN where not finite."""
    rows = own[own["seed"].isin(seeds) & (own["teacher"] == design.teacher)]
    return [
        rows.loc[(rows[PLACE] == list(cell.place)).all(axis=1), "angle"].to_numpy(float)
        for cell in design.cells
    ]


def _finding(
    name: str,
    rule: Rule,
    past: Sequence[Moments],
    reference: Moments,
    design: Design,
    look: int,
    affordable: int,
) -> Finding:
    teacher = past[-1]
    found = difference(teacher, reference, design.slopes)
    value = float(found.value)
    low, high = (float(np.clip(end, -LARGEST, LARGEST)) for end in rule.interval(found, look))
    verdict = Verdict(str(rule.verdicts(found, look)))
    ends = len(design.looks) - 1, max(affordable, look)
    power, within = (
        1.0 if verdict != Verdict.OPEN else float(rule.power(teacher, reference, design.slopes, last))
        for last in ends
    )
    unbiased = value
    if found.error > 0:
        errors = [_error(teacher, reference, design, seeds) for seeds in design.looks[: look + 1]]
        reaches = [
            rule.reach(difference(each, reference, design.slopes), number, above=value > 0)
            for number, each in enumerate(past[:-1])
        ]
        bounds = [float(reach) / error for reach, error in zip(reaches, errors, strict=False)]
        unbiased = median_unbiased(value / errors[-1], bounds, [error**-2 for error in errors])
    return Finding(name, design.looks[look], value, unbiased, low, high, verdict, power, within)


def _error(teacher: Moments, reference: Moments, design: Design, seeds: int) -> float:
    """Return the standard error that a look with `seeds` has, by the variances seen so far."""
    counts = np.full_like(teacher.runs, float(seeds))
    return float(difference(Moments(teacher.mean, teacher.variance, counts), reference, design.slopes).error)


def _ending(settled: Sequence[Finding], look: int, design: Design) -> Ending:
    still = [each for each in settled if each.verdict == Verdict.OPEN]
    if not still:
        return Ending.DECIDED
    if look == len(design.looks) - 1:
        return Ending.LAST
    return Ending.FUTILE if all(each.power < FUTILE for each in still) else Ending.GOES_ON


def course(design: Design, released: Released, looks: list[Look], reference: str) -> pd.DataFrame:
    """Return a row for each look of one comparison, those to come as the release lets expect them.

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
    """Return the learning curves of the new teacher and of both references, over the cells of the trial.

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
