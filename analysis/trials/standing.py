"""The standing of a trial: its comparisons at each look that is complete, as numbers, charts and words."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np
import pandas as pd

from analysis.comparisons.against_random import LARGEST
from analysis.comparisons.verdicts import AXES, on_both_axes
from analysis.data.columns import CELL
from analysis.data.frames import Frames
from analysis.data.reference import is_baseline
from analysis.formatting import ends, number
from analysis.measures.evaluations import aggregate
from analysis.measures.tested import FINAL, HEADLINE
from analysis.names import label
from analysis.trials.boundaries import median_unbiased
from analysis.trials.design import TRIALS, Design, detectable, moments_of, planned
from analysis.trials.rules import ERROR, FUTILE, Moments, Verdict, difference
from tma_ray.support.texts import counted


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
        measure: measure that is compared, of `design.AXES`.
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

    measure: str
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
        findings: comparisons as they are at this look, by the measure that ends trials first.
        settled: comparisons as they were when they were decided, or else as they are, in the same order.
        ending: reason why the trial ends here; None if it does not.
        excluded: runs left out, whose returns are not finite.
    """

    seeds: int
    findings: tuple[Finding, ...]
    settled: tuple[Finding, ...]
    ending: Ending
    excluded: int = 0

    def pairs(self) -> Iterator[tuple[Finding, ...]]:
        """Yield for each reference its settled findings, `HEADLINE` first and `FINAL` where there is one."""
        for reference in dict.fromkeys(each.reference for each in self.settled):
            yield tuple(each for each in self.settled if each.reference == reference)


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
    references = {
        (measure, name): moments_of(released, name, design.places, measure)
        for measure in design.axes
        for name in design.references
    }
    found: list[Look] = []
    decided: dict[tuple[str, str], Finding] = {}
    past: dict[str, list[Moments]] = {measure: [] for measure in design.axes}
    for look, seeds in enumerate(design.looks):
        rows = own[own["seed"].isin(design.seeds[:seeds])]
        counts = moments_of(rows, design.teacher, design.places).runs
        if counts.min() < seeds:
            break
        finite = rows[np.isfinite(rows["angle"])]
        for measure, moments in past.items():
            moments.append(moments_of(finite, design.teacher, design.places, measure))
        findings = []
        for key, reference in references.items():
            finding = _finding(key, past[key[0]], reference, design, affordable)
            findings.append(replace(finding, unbiased=math.nan) if key in decided else finding)
            if finding.verdict != Verdict.OPEN:
                decided.setdefault(key, finding)
        settled = tuple(decided.get((each.measure, each.reference), each) for each in findings)
        still = [each for each in settled if each.measure == HEADLINE and each.verdict == Verdict.OPEN]
        ending = Ending.GOES_ON
        if not still:
            ending = Ending.DECIDED
        elif look == len(design.looks) - 1:
            ending = Ending.LAST
        elif all(each.power < FUTILE for each in still):
            ending = Ending.FUTILE
        excluded = int((counts - past[HEADLINE][-1].runs).sum())
        found.append(Look(seeds, tuple(findings), settled, ending, excluded))
        if ending:
            break
    return found


def _finding(
    key: tuple[str, str], past: Sequence[Moments], reference: Moments, design: Design, affordable: int
) -> Finding:
    """Return the comparison by a measure with a reference, at the last of the `past` looks."""
    measure, name = key
    look, teacher, estimand = len(past) - 1, past[-1], design.estimand(measure)
    rule = design.rule(name, reference.runs, measure)
    found = difference(teacher, reference, estimand)
    value = float(found.value)
    low, high = (float(np.clip(end, -LARGEST, LARGEST)) for end in rule.interval(found, look))
    verdict = Verdict(str(rule.verdicts(found, look)))
    power, within = (
        1.0 if verdict != Verdict.OPEN else float(rule.power(teacher, reference, estimand, last))
        for last in (len(design.looks) - 1, max(affordable, look))
    )
    unbiased = value
    if found.freedom > 0:  # each look would have that of the variances seen so far
        counts = [np.full_like(teacher.runs, float(seeds)) for seeds in design.looks[: look + 1]]
        errors = [
            float(difference(replace(teacher, runs=runs), reference, estimand).error) for runs in counts
        ]
        reaches = [
            rule.reach(difference(each, reference, estimand), earlier, above=value > 0)
            for earlier, each in enumerate(past[:-1])
        ]
        bounds = [float(reach) / error for reach, error in zip(reaches, errors, strict=False)]
        unbiased = median_unbiased(value / errors[-1], bounds, [error**-2 for error in errors])
    return Finding(measure, name, design.looks[look], value, unbiased, low, high, verdict, power, within)


def course(
    design: Design, released: pd.DataFrame, looks: list[Look], reference: str, measure: str = HEADLINE
) -> pd.DataFrame:
    """Return a row for each look of one comparison, those to come as the release lets expect them.

    Returns:
        seeds; value, low and high: difference and repeated confidence interval, NaN of looks to come;
        verdict; better and worse: differences beyond which the teacher is; in points.
    """
    runs = moments_of(released, reference, design.places).runs
    rule, expectations = design.rule(reference, runs, measure), planned(design, runs, measure)
    rows = []
    for look, (seeds, expected) in enumerate(zip(design.looks, expectations, strict=True)):
        reaches = [float(rule.reach(expected, look, above=above)) for above in (True, False)]
        better, worse = reaches[0], -reaches[1]
        row: list[Any] = [seeds, math.nan, math.nan, math.nan, ""]
        if look < len(looks):
            key = measure, reference
            found = next(each for each in looks[look].findings if (each.measure, each.reference) == key)
            better, worse = found.value - found.low, found.value - found.high
            row = [seeds, found.value, found.low, found.high, found.verdict.value]
        rows.append([*row, *(max(-LARGEST, min(LARGEST, end)) for end in (better, worse))])
    return pd.DataFrame(rows, columns=["seeds", "value", "low", "high", "verdict", "better", "worse"])


def curves(design: Design, frames: Frames, own: Frames) -> pd.DataFrame:
    """Return the learning curves of the new teacher and of both references, over the cells of the trial.

    Returns:
        teacher, step, n, mean, std and standard_error of the mastered test tasks, in per cent.
    """
    places = pd.DataFrame(design.places, columns=CELL)
    found = []
    for source, names in ((frames, design.references), (own, (design.teacher,))):
        cells = source.cells[source.cells["teacher"].isin(names)].astype(dict.fromkeys(CELL, str))
        runs = cells.merge(places, on=CELL)[["teacher", "run_id"]].drop_duplicates()
        rows = source.measured[["run_id", "step", "mastered_percent"]].astype({"run_id": object})
        found.append(runs.astype(object).merge(rows, on="run_id"))
    return aggregate(pd.concat(found, ignore_index=True), "mastered_percent", ["teacher"])


ENDINGS = {
    Ending.DECIDED: "both comparisons are decided",
    Ending.FUTILE: f"no open comparison has a chance of {100 * FUTILE:.0f} % to be decided by the last look",
    Ending.LAST: "this was the last look",
}
"""Why a trial ends, in words."""

QUANTITIES = {HEADLINE: "on average over training", FINAL: "over the last three evaluations"}
"""What the differences of each measure are of, in points of mastered test tasks."""


def plan_lines(design: Design, released: pd.DataFrame) -> Iterator[str]:
    """Yield what a trial will do and what it can show, before anything is spent."""
    cells, looks, seeds = design.cells, design.looks, design.seeds
    references = {name: moments_of(released, name, design.places).runs for name in design.references}
    found = max(detectable(design, name, runs) for name, runs in references.items())
    others = (
        f"the best of {design.candidates} teachers" if design.candidates > 1 else "its only other teacher"
    )
    yield f"trial of {label(design.teacher)} against {design.release}"
    yield f"  compared with: Random, and {label(design.best)}, {others} there"
    yield f"  {counted(len(cells), 'cell')}, in this order: {', '.join(cell.name for cell in cells)}"
    yield (
        f"  looks after {_looks(design)} seeds of every cell (seeds {seeds[0]} to {seeds[-1]}): "
        f"{', '.join(str(count * len(cells)) for count in looks)} runs, at most {looks[-1] * len(cells)}"
    )
    yield f"  differences in {_quantity(design)}; each challenge counts once; {_margins(design)}"
    yield (
        f"  a wrong verdict in at most {100 * ERROR:.0f} % of such trials, both comparisons and all looks "
        f"together ({100 * design.simulated_error:.1f} % of simulated ones)"
    )
    yield (
        f"  finds a difference of {number(found)} points over training with a probability of 0.8; "
        f"stops early for success, likeness, and when nothing is likely to be decided"
    )


def look_line(look: Look) -> str:
    """Return the verdicts of a look in a line."""
    said = []
    for pair in look.pairs():
        numbers = []
        for each in pair:
            chance = ""
            if each.measure == HEADLINE and each.verdict == Verdict.OPEN:
                chance = f"; decided by the last look with probability {each.power:.2f}"
                if each.within_budget != each.power:
                    chance += f", within the budget {each.within_budget:.2f}"
            numbers.append(f"{AXES[each.measure]} {number(each.value)} {ends(each.low, each.high)}{chance}")
        said.append(f"beside {label(pair[0].reference)} {_in_words(pair)} ({'; '.join(numbers)})")
    excluded = f" {counted(look.excluded, 'run')} with returns that are not finite left out."
    end = f" Ends: {ENDINGS[look.ending]}." if look.ending else ""
    return f"look after {look.seeds} seeds: {'; '.join(said)}.{excluded if look.excluded else ''}{end}"


def _in_words(pair: Sequence[Finding]) -> str:
    """Return the verdicts against one reference in words."""
    if len(pair) == 1:
        return f"{pair[0].verdict} over training"
    return on_both_axes(*(each.verdict for each in pair))


def _quantity(design: Design) -> str:
    """Return the unit of differences on all axes, in words."""
    parts = [f"{QUANTITIES[measure]} ({AXES[measure]})" for measure in design.axes]
    return f"points of test tasks mastered {' and '.join(parts)}"


def _margins(design: Design) -> str:
    """Return the margins within which teachers are alike, in words."""
    margins = [f"{design.margin_of(measure):g} ({AXES[measure]})" for measure in design.axes]
    return f"alike is within {' and '.join(margins)} points"


def sentence(design: Design, look: Look) -> str:
    """Return the verdict of a trial as one sentence."""
    said = []
    for pair in look.pairs():
        name = label(pair[0].reference)
        if not is_baseline(pair[0].reference):
            name += f", the best of {design.candidates} there"
        numbers = [f"{AXES[e.measure]} {number(e.unbiased)} {ends(e.low, e.high)}" for e in pair]
        said.append(f"beside {name}: {_in_words(pair)} ({', '.join(numbers)})")
    return (
        f"Over {counted(len(design.cells), 'cell')} of {design.release}, {label(design.teacher)} "
        f"{'; '.join(said)}; "
        f"in {_quantity(design)}, after {look.seeds} of at most {design.looks[-1]} seeds of each cell: a "
        f"group-sequential test with repeated confidence intervals, whose verdicts are wrong in at most "
        f"{100 * ERROR:.0f} % of trials; {_margins(design)}."
    )


def verdict_table(design: Design, looks: list[Look]) -> pd.DataFrame:
    """Return a row for each comparison at each look.

    Returns:
        compared with, axis (of `verdicts.AXES`), seeds, runs, difference, low and high (repeated confidence
        interval), estimate (median-unbiased), verdict, chance (of a verdict by the last look); in points.
    """
    return pd.DataFrame(
        [
            {
                "compared with": label(each.reference),
                "axis": AXES[each.measure],
                "seeds": look.seeds,
                "runs": look.seeds * len(design.cells),
                "difference": each.value,
                "low": each.low,
                "high": each.high,
                "estimate": each.unbiased,
                "verdict": each.verdict.value,
                "chance": each.power,
            }
            for look in looks
            for each in look.findings
        ]
    )


def latex_row(design: Design, look: Look) -> str:
    r"""Return a row of a table in LaTeX: teacher, seeds, runs; estimate, interval and verdict of each.

    Against Random and the best sooner, then against both in the end.
    """
    found = [
        rf"${each.unbiased:+.1f}$ $[{each.low:+.1f}, {each.high:+.1f}]$ ({each.verdict.value})"
        for each in look.settled
    ]
    name = "".join(f"\\{each}" if each in "_%&#$" else each for each in label(design.teacher))
    cells = [name, str(look.seeds), str(look.seeds * len(design.cells)), *found]
    return " & ".join(cells) + r" \\" + "\n"


def methods(design: Design, look: Look, versions: str) -> str:
    """Return the paragraph on methods of a paper, with the numbers of this trial."""
    cells, runs = ", ".join(cell.name for cell in design.cells), look.seeds * len(design.cells)
    beside = (
        "The mean of the last three evaluations is reported beside by the same intervals, and ends no trial. "
    )
    return (
        f"{label(design.teacher)} was tried against the release {design.release} on "
        f"{counted(len(design.cells), 'cell')} ({cells}) by a group-sequential design that was fixed before "
        f"the first run. Looks were planned after {_looks(design)} seeds of every cell; it ended after "
        f"{look.seeds} (seeds {design.seeds[0]} to {design.seeds[look.seeds - 1]}, {runs} runs; "
        f"{ENDINGS.get(look.ending, 'going on')}). The measure is the mean percentage of mastered test tasks "
        f"over training, on the arcsine scale. {beside if FINAL in design.axes else ''}Differences are means "
        f"over {_weighting(design)}, with "
        f"Welch's standard error and Satterthwaite's degrees of freedom; in the standard error the variance "
        f"of a teacher counts with at least half of the mean variance of the release's teachers in the same "
        f"cell. The two comparisons, with Random "
        f"and with {label(design.best)}, the best of {design.candidates} released teachers, share an error "
        f"of {design.error:g} equally (Bonferroni). It is spent over the looks by Lan and DeMets' function "
        f"like O'Brien and Fleming's, separately at both ends of repeated confidence intervals, with "
        f"Student's quantiles; the upper end of the second allows for the choice of the best (Šidák). A "
        f"teacher is better or worse where the interval leaves out 0, and {_margins(design)}. "
        f"In {TRIALS:,} simulated trials with each released teacher's own residuals verdicts "
        f"were wrong in {100 * design.simulated_error:.1f} %. Estimates are median-unbiased by the "
        f"stagewise order. {versions}"
    )


def _weighting(design: Design) -> str:
    old = any(cell.weight is None for cell in design.cells)
    return "cells of equal weight" if old else "challenges of equal weight, the bodies of each equal"


def _looks(design: Design) -> str:
    return ", ".join(map(str, design.looks[:-1])) + f" and {design.looks[-1]}"
