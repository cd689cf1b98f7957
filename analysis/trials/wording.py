"""Trials in words: the plan, a line a look, the verdict as one sentence, and a table."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from analysis.data.reference import is_baseline
from analysis.formatting import ends, number
from analysis.names import label
from analysis.trials.design import TRIALS, Design, detectable, moments_of
from analysis.trials.rules import ERROR, FUTILE, Verdict
from analysis.trials.standing import Ending, Look
from tma_ray.commands.texts import counted

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
