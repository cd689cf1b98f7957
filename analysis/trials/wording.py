"""Trials in words: the plan, a line a look, the verdict as one sentence, and a table."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from analysis.data.reference import is_baseline
from analysis.formatting import ends, number
from analysis.names import label
from analysis.trials.design import TRIALS, Design, Released, detectable
from analysis.trials.rules import ERROR, FUTILE, Verdict
from analysis.trials.standing import Ending, Finding, Look
from tma_ray.commands.texts import counted

ENDINGS = {
    Ending.DECIDED: "both comparisons are decided",
    Ending.FUTILE: f"no open comparison has a chance of {100 * FUTILE:.0f} % to be decided by the last look",
    Ending.LAST: "this was the last look",
}
"""Why a trial ends, in words."""

GOING_ON = "going on"

QUANTITY = "points of test tasks mastered on average over training"
"""The unit of differences."""


def plan_lines(design: Design, released: Released) -> Iterator[str]:
    """Yield what a trial will do and what it can show, before anything is spent."""
    cells = [cell.name for cell in design.cells]
    most = design.looks[-1] * len(cells)
    found = [
        detectable(design, name, released.moments(name, [cell.place for cell in design.cells]).runs)
        for name in design.references
    ]
    chosen = (
        f"the best of {design.candidates} teachers" if design.candidates > 1 else "its only other teacher"
    )
    yield f"trial of {label(design.teacher)} against {design.release}"
    yield f"  compared with: Random, and {label(design.best)}, {chosen} there"
    yield f"  {counted(len(cells), 'cell')}, in this order: {', '.join(cells)}"
    yield (
        f"  looks after {_looks(design)} seeds of every cell (seeds {design.seeds[0]} to "
        f"{design.seeds[-1]}): {', '.join(str(seeds * len(cells)) for seeds in design.looks)} runs, at most "
        f"{most}"
    )
    yield f"  differences in {QUANTITY}; within {design.margin:g} points two teachers are alike"
    yield (
        f"  a wrong verdict in at most {100 * ERROR:.0f} % of such trials, both comparisons and all looks "
        f"together ({100 * design.simulated_error:.1f} % of simulated ones)"
    )
    yield (
        f"  finds a difference of {number(max(found))} points with a probability of 0.8; "
        f"stops early for success, likeness, and when nothing is likely to be decided"
    )


def look_line(look: Look) -> str:
    """Return the verdicts of a look in a line."""
    said = "; ".join(_standing(finding) for finding in look.settled)
    end = f" Ends: {ENDINGS[look.ending]}." if look.ending else ""
    left_out = (
        f" {counted(look.excluded, 'run')} with returns that are not finite left out."
        if look.excluded
        else ""
    )
    return f"look after {look.seeds} seeds: {said}.{left_out}{end}"


def _standing(finding: Finding) -> str:
    where = f"{number(finding.value)} {ends(finding.low, finding.high)}"
    name = label(finding.reference)
    if finding.verdict == Verdict.OPEN:
        chance = f"decided by the last look with probability {finding.power:.2f}"
        if finding.within_budget != finding.power:
            chance += f", within the budget {finding.within_budget:.2f}"
        return f"open against {name} ({where}; {chance})"
    return f"{_relation(finding)} {name} ({where})"


def _relation(finding: Finding) -> str:
    words = {Verdict.BETTER: "better than", Verdict.WORSE: "worse than", Verdict.ALIKE: "like"}
    return words.get(finding.verdict, "undecided against")


def sentence(design: Design, look: Look) -> str:
    """Return the verdict of a trial as one sentence."""
    said = " and ".join(
        f"{_relation(each)} {label(each.reference)}{_best(design, each)} ({_numbers(each)})"
        for each in look.settled
    )
    return (
        f"Over {counted(len(design.cells), 'cell')} of {design.release}, {label(design.teacher)} is {said}, "
        f"in {QUANTITY}, after {look.seeds} of at most {design.looks[-1]} seeds of each cell: a "
        f"group-sequential test with repeated confidence intervals, whose verdicts are wrong in at most "
        f"{100 * ERROR:.0f} % of trials; alike means within {design.margin:g} points."
    )


def _best(design: Design, finding: Finding) -> str:
    return "" if is_baseline(finding.reference) else f", the best of {design.candidates} there"


def _numbers(finding: Finding) -> str:
    return f"{number(finding.unbiased)} {ends(finding.low, finding.high)}"


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
    cells = [_escaped(label(design.teacher)), str(look.seeds), str(look.seeds * len(design.cells)), *found]
    return " & ".join(cells) + r" \\" + "\n"


def _escaped(text: str) -> str:
    return "".join(f"\\{each}" if each in "_%&#$" else each for each in text)


def methods(design: Design, look: Look, versions: str) -> str:
    """Return the paragraph on methods of a paper, with the numbers of this trial."""
    cells, runs = ", ".join(cell.name for cell in design.cells), look.seeds * len(design.cells)
    return (
        f"{label(design.teacher)} was tried against the release {design.release} on "
        f"{counted(len(design.cells), 'cell')} ({cells}) by a group-sequential design that was fixed before "
        f"the first run. Looks were planned after {_looks(design)} seeds of every cell; it ended after "
        f"{look.seeds} (seeds {design.seeds[0]} to {design.seeds[look.seeds - 1]}, {runs} runs; "
        f"{ENDINGS.get(look.ending, GOING_ON)}). The measure is the mean percentage of mastered test tasks "
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
