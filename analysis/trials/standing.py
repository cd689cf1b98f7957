"""The standing of a trial: its comparisons at each look that is complete, as numbers, charts and words."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np
import pandas as pd

from analysis.data.frames import Frames
from analysis.data.reference import is_baseline
from analysis.formatting import ends, number
from analysis.measures.evaluations import aggregate
from analysis.names import label
from analysis.trials.boundaries import median_unbiased
from analysis.trials.design import PLACE, TRIALS, Design, detectable, moments_of, planned
from analysis.trials.rules import ERROR, FUTILE, Moments, Verdict, difference
from tma_ray.commands.texts import counted

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
    for look, seeds in enumerate(design.looks):
        rows = own[own["seed"].isin(design.seeds[:seeds])]
        counts = moments_of(rows, design.teacher, design.places).runs
        if counts.min() < seeds:
            break
        past.append(moments_of(rows[np.isfinite(rows["angle"])], design.teacher, design.places))
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
        elif look == len(design.looks) - 1:
            ending = Ending.LAST
        elif all(each.power < FUTILE for each in still):
            ending = Ending.FUTILE
        excluded = int((counts - past[-1].runs).sum())
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
            rule.reach(difference(each, reference, slopes), earlier, above=value > 0)
            for earlier, each in enumerate(past[:-1])
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
    for look, (seeds, expected) in enumerate(zip(design.looks, planned(design, runs), strict=True)):
        reaches = [float(rule.reach(expected, look, above=above)) for above in (True, False)]
        better, worse = reaches[0], -reaches[1]
        row: list[Any] = [seeds, math.nan, math.nan, math.nan, ""]
        if look < len(looks):
            found = next(each for each in looks[look].findings if each.reference == reference)
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


ENDINGS = {
    Ending.DECIDED: "both comparisons are decided",
    Ending.FUTILE: f"no open comparison has a chance of {100 * FUTILE:.0f} % to be decided by the last look",
    Ending.LAST: "this was the last look",
}
"""Why a trial ends, in words."""

RELATIONS = {
    Verdict.BETTER: "better than",
    Verdict.WORSE: "worse than",
    Verdict.ALIKE: "like",
    Verdict.OPEN: "undecided against",
}

QUANTITY = "points of test tasks mastered on average over training"
"""The unit of differences."""


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
    yield f"  differences in {QUANTITY}; within {design.margin:g} points two teachers are alike"
    yield (
        f"  a wrong verdict in at most {100 * ERROR:.0f} % of such trials, both comparisons and all looks "
        f"together ({100 * design.simulated_error:.1f} % of simulated ones)"
    )
    yield (
        f"  finds a difference of {number(found)} points with a probability of 0.8; "
        f"stops early for success, likeness, and when nothing is likely to be decided"
    )


def look_line(look: Look) -> str:
    """Return the verdicts of a look in a line."""
    said = []
    for each in look.settled:
        where = f"{number(each.value)} {ends(each.low, each.high)}"
        if each.verdict == Verdict.OPEN:
            where += f"; decided by the last look with probability {each.power:.2f}"
            if each.within_budget != each.power:
                where += f", within the budget {each.within_budget:.2f}"
        relation = "open against" if each.verdict == Verdict.OPEN else RELATIONS[each.verdict]
        said.append(f"{relation} {label(each.reference)} ({where})")
    excluded = f" {counted(look.excluded, 'run')} with returns that are not finite left out."
    end = f" Ends: {ENDINGS[look.ending]}." if look.ending else ""
    return f"look after {look.seeds} seeds: {'; '.join(said)}.{excluded if look.excluded else ''}{end}"


def sentence(design: Design, look: Look) -> str:
    """Return the verdict of a trial as one sentence."""
    said = []
    for each in look.settled:
        best = "" if is_baseline(each.reference) else f", the best of {design.candidates} there"
        numbers = f"{number(each.unbiased)} {ends(each.low, each.high)}"
        said.append(f"{RELATIONS[each.verdict]} {label(each.reference)}{best} ({numbers})")
    return (
        f"Over {counted(len(design.cells), 'cell')} of {design.release}, {label(design.teacher)} is "
        f"{' and '.join(said)}, "
        f"in {QUANTITY}, after {look.seeds} of at most {design.looks[-1]} seeds of each cell: a "
        f"group-sequential test with repeated confidence intervals, whose verdicts are wrong in at most "
        f"{100 * ERROR:.0f} % of trials; alike means within {design.margin:g} points."
    )


def verdict_table(design: Design, looks: list[Look]) -> pd.DataFrame:
    """Return a row for each comparison at each look.

    Returns:
        compared with, seeds, difference, low and high (repeated confidence interval), estimate
        (median-unbiased), verdict, chance (of a verdict by the last look); in points.
    """
    return pd.DataFrame(
        [
            {
                "compared with": label(each.reference),
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
    r"""Return a row of a table in LaTeX: teacher, seeds, runs; estimate, interval and verdict of each."""
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
    return (
        f"{label(design.teacher)} was tried against the release {design.release} on "
        f"{counted(len(design.cells), 'cell')} ({cells}) by a group-sequential design that was fixed before "
        f"the first run. Looks were planned after {_looks(design)} seeds of every cell; it ended after "
        f"{look.seeds} (seeds {design.seeds[0]} to {design.seeds[look.seeds - 1]}, {runs} runs; "
        f"{ENDINGS.get(look.ending, 'going on')}). The measure is the mean percentage of mastered test tasks "
        f"over training, on the arcsine scale. Differences are means over cells of equal weight, with "
        f"Welch's standard error and Satterthwaite's degrees of freedom. The two comparisons, with Random "
        f"and with {label(design.best)}, the best of {design.candidates} released teachers, share an error "
        f"of {design.error:g} equally (Bonferroni). It is spent over the looks by Lan and DeMets' function "
        f"like O'Brien and Fleming's, separately at both ends of repeated confidence intervals, with "
        f"Student's quantiles; the upper end of the second allows for the choice of the best (Šidák). A "
        f"teacher is better or worse where its interval leaves out 0, and alike where it is within "
        f"{design.margin:g} points. In {TRIALS:,} simulated trials with the release's residuals verdicts "
        f"were wrong in {100 * design.simulated_error:.1f} %. Estimates are median-unbiased by the "
        f"stagewise order. {versions}"
    )


def _looks(design: Design) -> str:
    return ", ".join(map(str, design.looks[:-1])) + f" and {design.looks[-1]}"
