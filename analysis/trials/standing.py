"""The standing of a trial: its comparisons at each look that is complete, and what charts show of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np
import pandas as pd

from analysis.data.frames import Frames
from analysis.measures.evaluations import aggregate
from analysis.trials.boundaries import median_unbiased
from analysis.trials.design import PLACE, Design, moments_of, planned
from analysis.trials.rules import FUTILE, Moments, Verdict, difference

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
    design: Design, released: pd.DataFrame, own: pd.DataFrame, affordable: int | None = None
) -> list[Look]:
    """Return the looks of a trial of which all runs have ended, none after one at which it ends.

    Args:
        design: fixed design of the trial.
        released: runs of the release, of `design.released_runs`.
        own: runs of the new teacher, of `design.ended_runs`.
        affordable: number of the last look within the budget, from 0 on; None for all.
    """
    affordable = len(design.looks) - 1 if affordable is None else affordable
    references = {name: moments_of(released, name, design.places) for name in design.references}
    found: list[Look] = []
    decided: dict[str, Finding] = {}
    past: list[Moments] = []
    for number, seeds in enumerate(design.looks):
        rows = own[own["seed"].isin(design.seeds[:seeds])]
        finite = rows[np.isfinite(rows["angle"])]
        if moments_of(rows, design.teacher, design.places).runs.min() < seeds:
            break
        past.append(moments_of(finite, design.teacher, design.places))
        findings = []
        for name, reference in references.items():
            finding = _finding(name, past, reference, design, affordable)
            findings.append(replace(finding, unbiased=math.nan) if name in decided else finding)
            if finding.verdict != Verdict.OPEN:
                decided.setdefault(name, finding)
        settled = tuple(decided.get(each.reference, each) for each in findings)
        still = [each for each in settled if each.verdict == Verdict.OPEN]
        ending = Ending.GOES_ON
        if not still:
            ending = Ending.DECIDED
        elif number == len(design.looks) - 1:
            ending = Ending.LAST
        elif all(each.power < FUTILE for each in still):
            ending = Ending.FUTILE
        excluded = int((rows["teacher"] == design.teacher).sum() - past[-1].runs.sum())
        found.append(Look(seeds, tuple(findings), settled, ending, excluded))
        if ending:
            break
    return found


def _finding(
    name: str, past: Sequence[Moments], reference: Moments, design: Design, affordable: int
) -> Finding:
    """Return the comparison with a reference at a look, the last of the `past` ones."""
    look, teacher, slopes = len(past) - 1, past[-1], design.slopes
    rule = design.rule(name, reference.runs)
    found = difference(teacher, reference, slopes)
    value = float(found.value)
    low, high = (float(np.clip(end, -LARGEST, LARGEST)) for end in rule.interval(found, look))
    verdict = Verdict(str(rule.verdicts(found, look)))
    power, within = (
        1.0 if verdict != Verdict.OPEN else float(rule.power(teacher, reference, slopes, last))
        for last in (len(design.looks) - 1, max(affordable, look))
    )
    unbiased = value
    if found.error > 0:  # each look would have that of the variances seen so far
        counts = [np.full_like(teacher.runs, float(seeds)) for seeds in design.looks[: look + 1]]
        errors = [float(difference(replace(teacher, runs=runs), reference, slopes).error) for runs in counts]
        reaches = [
            rule.reach(difference(each, reference, slopes), number, above=value > 0)
            for number, each in enumerate(past[:-1])
        ]
        bounds = [float(reach) / error for reach, error in zip(reaches, errors, strict=False)]
        unbiased = median_unbiased(value / errors[-1], bounds, [error**-2 for error in errors])
    return Finding(name, design.looks[look], value, unbiased, low, high, verdict, power, within)


def course(design: Design, released: pd.DataFrame, looks: list[Look], reference: str) -> pd.DataFrame:
    """Return a row for each look of one comparison, those to come as the release lets expect them.

    Returns:
        seeds; value, low and high: difference and repeated confidence interval, NaN of looks to come;
        verdict; better and worse: differences beyond which the teacher is; in points.
    """
    runs = moments_of(released, reference, design.places).runs
    rule = design.rule(reference, runs)
    rows = []
    for number, (seeds, expected) in enumerate(zip(design.looks, planned(design, runs), strict=True)):
        ends = [float(rule.reach(expected, number, above=above)) for above in (True, False)]
        better, worse = ends[0], -ends[1]
        row: list[Any] = [seeds, math.nan, math.nan, math.nan, ""]
        if number < len(looks):
            found = next(each for each in looks[number].findings if each.reference == reference)
            better, worse = found.value - found.low, found.value - found.high
            row = [seeds, found.value, found.low, found.high, found.verdict.value]
        rows.append([*row, *(max(-LARGEST, min(LARGEST, end)) for end in (better, worse))])
    return pd.DataFrame(rows, columns=["seeds", "value", "low", "high", "verdict", "better", "worse"])


def curves(design: Design, frames: Frames, own: Frames) -> pd.DataFrame:
    """Return the learning curves of the new teacher and of both references, over the cells of the trial.

    Returns:
        teacher, step, n, mean, std and standard_error of the mastered test tasks, in per cent.
    """
    places = pd.DataFrame(design.places, columns=PLACE)
    found = []
    for source, names in ((frames, design.references), (own, (design.teacher,))):
        cells = source.cells[source.cells["teacher"].isin(names)].astype(dict.fromkeys(PLACE, str))
        runs = cells.merge(places, on=PLACE)[["teacher", "run_id"]].drop_duplicates()
        rows = source.measured[["run_id", "step", "mastered_percent"]].astype({"run_id": object})
        found.append(runs.astype(object).merge(rows, on="run_id"))
    return aggregate(pd.concat(found, ignore_index=True), "mastered_percent", ["teacher"])
