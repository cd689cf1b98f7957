"""Results of trials: comparisons at completed interim looks, with tables and texts about them."""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np
import pandas as pd

from analysis.baselines.catalogue import Baseline
from analysis.comparisons.against_random import LARGEST
from analysis.data.columns import CELL_COLUMNS
from analysis.data.frames import Frames
from analysis.data.reference import is_baseline
from analysis.formatting import interval_text, number, steps_text
from analysis.measures.evaluations import aggregate
from analysis.measures.tested import AXES, FINAL, HEADLINE, on_both_axes
from analysis.names import label
from analysis.trials.boundaries import median_unbiased
from analysis.trials.design import (
    TRIALS,
    Design,
    detectable,
    ended_runs,
    make_design,
    moments_of,
    planned,
    released_runs,
)
from analysis.trials.rules import ERROR, FUTILE, Moments, TrialVerdict, difference
from tma_ray.support.texts import counted


class TrialEnding(StrEnum):
    """Reason why a trial ends at a look, or `GOES_ON`."""

    DECIDED = "decided"  # both comparisons have a verdict
    FUTILE = "futile"  # no open comparison is likely to get a verdict
    LAST = "last look"  # all looks are completed
    GOES_ON = ""  # the trial continues


@dataclass(frozen=True)
class LookComparison:
    """Comparison of the new teacher with a reference at an interim look, in points."""

    measure: str  # measure that is compared, one of `design.AXES`
    reference: str  # teacher with which the new one is compared
    seeds: int  # number of the new teacher's seeds per cell so far
    value: float  # observed difference
    unbiased: float  # median-unbiased estimate, corrected for earlier looks; NaN after a verdict
    low: float  # lower end of the repeated confidence interval
    high: float  # upper end of the interval
    verdict: TrialVerdict  # verdict based on the interval
    power: float  # predictive power at the final look; 1 after a verdict
    within_budget: float  # predictive power at the last look that the budget allows


@dataclass(frozen=True)
class InterimLook:
    """Interim look of a trial, with its comparisons."""

    seeds: int  # number of the new teacher's seeds per cell so far
    comparisons: tuple[LookComparison, ...]  # comparisons, first by the measure that can end a trial
    settled: tuple[LookComparison, ...]  # comparisons, each at the look of its verdict, or at this look
    ending: TrialEnding  # reason why the trial ends here, or `GOES_ON`
    excluded: int = 0  # number of runs excluded for non-finite returns

    def pairs(self) -> Iterator[tuple[LookComparison, ...]]:
        """Yield, for each reference, the settled comparisons by `HEADLINE` and, if compared, by `FINAL`."""
        for reference in dict.fromkeys(comparison.reference for comparison in self.settled):
            yield tuple(comparison for comparison in self.settled if comparison.reference == reference)


def completed_looks(
    design: Design, released: pd.DataFrame, runs: pd.DataFrame, affordable: int | None = None
) -> list[InterimLook]:
    """Return the completed interim looks, up to the one that ended the trial.

    Args:
        design: design of the trial.
        released: runs of the release, from `design.released_runs`.
        runs: runs of the new teacher, from `design.ended_runs`.
        affordable: index of the last look within the budget; None for all.
    """
    affordable = len(design.looks) - 1 if affordable is None else affordable
    references = {
        (measure, name): moments_of(released, name, design.keys, measure)
        for measure in design.axes
        for name in design.references
    }
    looks: list[InterimLook] = []
    decided: dict[tuple[str, str], LookComparison] = {}
    past: dict[str, list[Moments]] = {measure: [] for measure in design.axes}
    for look, seeds in enumerate(design.looks):
        rows = runs[runs["seed"].isin(design.seeds[:seeds])]
        counts = moments_of(rows, design.teacher, design.keys).runs
        if counts.min() < seeds:
            break
        finite = rows[np.isfinite(rows["angle"])]
        for measure, moments in past.items():
            moments.append(moments_of(finite, design.teacher, design.keys, measure))
        comparisons = []
        for key, reference in references.items():
            comparison = _comparison(key, past[key[0]], reference, design, affordable)
            comparisons.append(replace(comparison, unbiased=math.nan) if key in decided else comparison)
            if comparison.verdict != TrialVerdict.OPEN:
                decided.setdefault(key, comparison)
        settled = tuple(decided.get((result.measure, result.reference), result) for result in comparisons)
        undecided = [
            comparison
            for comparison in settled
            if comparison.measure == HEADLINE and comparison.verdict == TrialVerdict.OPEN
        ]
        ending = TrialEnding.GOES_ON
        if not undecided:
            ending = TrialEnding.DECIDED
        elif look == len(design.looks) - 1:
            ending = TrialEnding.LAST
        elif all(comparison.power < FUTILE for comparison in undecided):
            ending = TrialEnding.FUTILE
        excluded = int((counts - past[HEADLINE][-1].runs).sum())
        looks.append(InterimLook(seeds, tuple(comparisons), settled, ending, excluded))
        if ending:
            break
    return looks


def _comparison(
    key: tuple[str, str], past: Sequence[Moments], reference: Moments, design: Design, affordable: int
) -> LookComparison:
    """Return the comparison with a reference, by one measure, at the last of the `past` looks."""
    measure, name = key
    look, teacher, estimand = len(past) - 1, past[-1], design.estimand(measure)
    rule = design.rule(name, reference.runs, measure)
    estimate = difference(teacher, reference, estimand)
    value = float(estimate.value)
    low, high = (float(np.clip(end, -LARGEST, LARGEST)) for end in rule.interval(estimate, look))
    verdict = TrialVerdict(str(rule.verdicts(estimate, look)))
    power, within = (
        1.0 if verdict != TrialVerdict.OPEN else float(rule.power(teacher, reference, estimand, last))
        for last in (len(design.looks) - 1, max(affordable, look))
    )
    unbiased = value
    if estimate.freedom > 0:  # information at every look so far, from current variances
        counts = [np.full_like(teacher.runs, float(seeds)) for seeds in design.looks[: look + 1]]
        errors = [
            float(difference(replace(teacher, runs=runs), reference, estimand).error) for runs in counts
        ]
        reaches = [
            rule.reach(difference(moments, reference, estimand), earlier, above=value > 0)
            for earlier, moments in enumerate(past[:-1])
        ]
        bounds = [float(reach) / error for reach, error in zip(reaches, errors, strict=False)]
        unbiased = median_unbiased(value / errors[-1], bounds, [error**-2 for error in errors])
    return LookComparison(
        measure, name, design.looks[look], value, unbiased, low, high, verdict, power, within
    )


def course(
    design: Design, released: pd.DataFrame, looks: list[InterimLook], reference: str, measure: str = HEADLINE
) -> pd.DataFrame:
    """Return a row for each look of one comparison, including expected boundaries for future looks.

    Returns:
        seeds; value, low and high (difference and repeated confidence interval, NaN for future looks);
        verdict; better and worse (boundaries of these verdicts); in points.
    """
    runs = moments_of(released, reference, design.keys).runs
    rule, expectations = design.rule(reference, runs, measure), planned(design, runs, measure)
    rows = []
    for look, (seeds, expected) in enumerate(zip(design.looks, expectations, strict=True)):
        reaches = [float(rule.reach(expected, look, above=above)) for above in (True, False)]
        better, worse = reaches[0], -reaches[1]
        row: list[Any] = [seeds, math.nan, math.nan, math.nan, ""]
        if look < len(looks):
            key = measure, reference
            seen = next(
                result for result in looks[look].comparisons if (result.measure, result.reference) == key
            )
            better, worse = seen.value - seen.low, seen.value - seen.high
            row = [seeds, seen.value, seen.low, seen.high, seen.verdict.value]
        rows.append([*row, *(max(-LARGEST, min(LARGEST, end)) for end in (better, worse))])
    return pd.DataFrame(rows, columns=["seeds", "value", "low", "high", "verdict", "better", "worse"])


def curves(design: Design, frames: Frames, trial_frames: Frames) -> pd.DataFrame:
    """Return the learning curves of the new teacher and both references over the cells of the trial.

    Returns:
        teacher, step, n, mean, std and standard_error of the mastered test tasks, in per cent.
    """
    keys = pd.DataFrame(design.keys, columns=CELL_COLUMNS)
    tables = []
    for source, names in ((frames, design.references), (trial_frames, (design.teacher,))):
        cells = source.cells[source.cells["teacher"].isin(names)].astype(dict.fromkeys(CELL_COLUMNS, str))
        runs = cells.merge(keys, on=CELL_COLUMNS)[["teacher", "run_id"]].drop_duplicates()
        rows = source.measured[["run_id", "step", "mastered_percent"]].astype({"run_id": object})
        rows = rows if design.steps is None else rows[rows["step"] <= design.steps]
        tables.append(runs.astype(object).merge(rows, on="run_id"))
    return aggregate(pd.concat(tables, ignore_index=True), "mastered_percent", ["teacher"])


def joined_trials(baseline: Baseline) -> list[tuple[Design, InterimLook]]:
    """Return the design and the last look of every trial through which a teacher joined a release.

    References are Random and the best teacher of the core, so joining changes no other verdict. Seeds follow
    those of the references. Designs are recomputed by the current rules.

    Raises:
        ValueError: if `make_design` refuses the core.
    """
    frames = baseline.frames()
    if not frames.core:
        return []
    core_frames = replace(frames, cells=frames.cells[frames.cells["core"]])
    design, released = make_design("", baseline, core_frames), released_runs(core_frames)
    ended = ended_runs(frames)
    first = int(ended.loc[ended["teacher"].isin(design.references), "seed"].max()) + 1
    design = replace(design, seeds=tuple(range(first, first + design.looks[-1])))
    newcomers = ended[~ended["teacher"].isin(core_frames.cells["teacher"])]
    trials = []
    for teacher, runs in newcomers.groupby("teacher"):
        design = replace(design, teacher=str(teacher))
        looks = completed_looks(design, released, runs)
        trials += [(design, looks[-1])] if looks else []
    return trials


REASONS = {
    TrialEnding.DECIDED: "both comparisons are decided",
    TrialEnding.FUTILE: f"no open comparison has a chance of {100 * FUTILE:.0f} % to be decided by the last "
    "look",
    TrialEnding.LAST: "this was the last look",
}
"""Phrase for each reason why a trial ends."""

AVERAGING = {HEADLINE: "on average over training", FINAL: "over the last three evaluations"}
"""Phrase for the averaging of each measure."""


def plan_lines(design: Design, released: pd.DataFrame) -> Iterator[str]:
    """Yield the lines that describe a design and its power."""
    cells, looks, seeds = design.cells, design.looks, design.seeds
    references = {name: moments_of(released, name, design.keys).runs for name in design.references}
    smallest = max(detectable(design, name, runs) for name, runs in references.items())
    others = (
        f"the best of {design.candidates} teachers" if design.candidates > 1 else "its only other teacher"
    )
    yield f"trial of {label(design.teacher)} against {_release(design)}"
    yield f"  compared with: Random, and {label(design.best)}, {others} there"
    yield f"  {counted(len(cells), 'cell')}, in this order: {_cell_names(design)}"
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
        f"  finds a difference of {number(smallest)} points over training with a probability of 0.8; "
        f"stops early for success, likeness, and when nothing is likely to be decided"
    )


def look_line(look: InterimLook) -> str:
    """Return the verdicts of a look as one line."""
    parts = []
    for pair in look.pairs():
        numbers = []
        for result in pair:
            chance = ""
            if result.measure == HEADLINE and result.verdict == TrialVerdict.OPEN:
                chance = f"; decided by the last look with probability {result.power:.2f}"
                if result.within_budget != result.power:
                    chance += f", within the budget {result.within_budget:.2f}"
            interval = interval_text(result.low, result.high)
            numbers.append(f"{AXES[result.measure]} {number(result.value)} {interval}{chance}")
        parts.append(f"beside {label(pair[0].reference)} {_verdict(pair)} ({'; '.join(numbers)})")
    excluded = f" {counted(look.excluded, 'run')} with returns that are not finite left out."
    end = f" Ends: {REASONS[look.ending]}." if look.ending else ""
    return f"look after {look.seeds} seeds: {'; '.join(parts)}.{excluded if look.excluded else ''}{end}"


def _verdict(pair: Sequence[LookComparison]) -> str:
    """Return the verdict against one reference, combined over its measures."""
    if len(pair) == 1:
        return f"{pair[0].verdict} over training"
    return on_both_axes(*(comparison.verdict for comparison in pair))


def _quantity(design: Design) -> str:
    """Return a phrase that defines differences: their unit, and how each measure is averaged."""
    parts = [f"{AVERAGING[measure]} ({AXES[measure]})" for measure in design.axes]
    return f"points of test tasks mastered {' and '.join(parts)}"


def _margins(design: Design) -> str:
    """Return a clause about the equivalence margins."""
    margins = [f"{design.margin_of(measure):g} ({AXES[measure]})" for measure in design.axes]
    return f"alike is within {' and '.join(margins)} points"


def sentence(design: Design, look: InterimLook) -> str:
    """Return the verdict of a trial as one sentence."""
    parts = []
    for pair in look.pairs():
        name = label(pair[0].reference)
        if not is_baseline(pair[0].reference):
            name += f", the best of {design.candidates} there"
        numbers = [
            f"{AXES[result.measure]} {number(result.unbiased)} {interval_text(result.low, result.high)}"
            for result in pair
        ]
        parts.append(f"beside {name}: {_verdict(pair)} ({', '.join(numbers)})")
    return (
        f"Over {counted(len(design.cells), 'cell')} of {_release(design)} ({_cell_names(design)}), "
        f"{label(design.teacher)} {'; '.join(parts)}; "
        f"in {_quantity(design)}, after {look.seeds} of at most {design.looks[-1]} seeds of each cell: a "
        f"group-sequential test with repeated confidence intervals, whose verdicts are wrong in at most "
        f"{100 * ERROR:.0f} % of trials; {_margins(design)}."
    )


def verdict_table(design: Design, looks: list[InterimLook]) -> pd.DataFrame:
    """Return a row for each comparison at each look.

    Returns:
        compared with, axis (of `tested.AXES`), seeds, runs, difference, low and high (repeated confidence
        interval), estimate (median-unbiased), verdict, chance (predictive power); in points.
    """
    return pd.DataFrame(
        [
            {
                "compared with": label(result.reference),
                "axis": AXES[result.measure],
                "seeds": look.seeds,
                "runs": look.seeds * len(design.cells),
                "difference": result.value,
                "low": result.low,
                "high": result.high,
                "estimate": result.unbiased,
                "verdict": result.verdict.value,
                "chance": result.power,
            }
            for look in looks
            for result in look.comparisons
        ]
    )


def latex_row(design: Design, look: InterimLook) -> str:
    r"""Return a LaTeX table row: teacher, seeds, runs, and the estimate of each settled comparison."""
    results = [
        rf"${result.unbiased:+.1f}$ $[{result.low:+.1f}, {result.high:+.1f}]$ ({result.verdict.value})"
        for result in look.settled
    ]
    name = re.sub(r"([_%&#$])", r"\\\1", label(design.teacher))
    cells = [name, str(look.seeds), str(look.seeds * len(design.cells)), *results]
    return " & ".join(cells) + r" \\" + "\n"


def methods(design: Design, look: InterimLook, versions: str) -> str:
    """Return the methods paragraph of a paper, with the numbers of the trial."""
    runs = look.seeds * len(design.cells)
    old = any(cell.weight is None for cell in design.cells)
    weighting = "cells of equal weight" if old else "challenges of equal weight, the bodies of each equal"
    beside = (
        "The mean of the last three evaluations is reported beside by the same intervals, and ends no trial. "
    )
    return (
        f"{label(design.teacher)} was tried against the release {_release(design)} on "
        f"{counted(len(design.cells), 'cell')} ({_cell_names(design)}) by a group-sequential design that was "
        f"fixed before the first run. Looks were planned after {_looks(design)} seeds of every cell; it "
        f"ended after {look.seeds} (seeds {design.seeds[0]} to {design.seeds[look.seeds - 1]}, {runs} runs; "
        f"{REASONS.get(look.ending, 'going on')}). The measure is the mean percentage of mastered test tasks "
        f"over training, on the arcsine scale. {beside if FINAL in design.axes else ''}Differences are means "
        f"over {weighting}, with "
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


def _release(design: Design) -> str:
    """Return the name of the release, followed by the steps after which its runs are measured, if given."""
    measured = "" if design.steps is None else f" after {steps_text(design.steps)} steps"
    return f"{design.release}{measured}"


def _cell_names(design: Design) -> str:
    return ", ".join(cell.name for cell in design.cells)


def _looks(design: Design) -> str:
    return ", ".join(map(str, design.looks[:-1])) + f" and {design.looks[-1]}"
