"""Headline measures of teachers, tests on them (paired by seed if runs share a student), and verdicts."""

from collections.abc import Hashable, Mapping, Sequence
from enum import StrEnum
from typing import Any, Final, TypeAlias

import pandas as pd

from analysis.statistics import (
    SIGNIFICANCE,
    Comparison,
    Description,
    paired,
    paired_strata,
    stratified,
    welch,
)
from analysis.statistics.samples import DEFAULT_MARGIN
from analysis.statistics.tests import seed_means
from tma_ray.results import SIMULATED

HEADLINE: Final = "mastered_area"
"""Measure of rankings and tests: mean percentage of mastered test tasks over the budget. It uses the whole
run, is comparable across budgets, and has the most power (`docs/statistics.md`)."""

FINAL: Final = "last_three"
"""Measure of final results: mean percentage of mastered test tasks at the last three evaluations."""

TRAINED: Final = "trained_area"
"""The headline per trained step: mean percentage of mastered test tasks over a number of trained steps."""

PAPERS: Final = "mastered_percent"
"""Measure of the paper: percentage of test tasks mastered at the last evaluation."""

MEASURES = {HEADLINE: "over training", FINAL: "in the end", PAPERS: "last evaluation"}
"""Measures in the order in which they are shown, with their table headings."""

AREA_MARGIN = DEFAULT_MARGIN / 2
"""Equivalence margin of means over training, in points: half of the margin at the end, since mastery grows
roughly linearly."""

MARGINS = {HEADLINE: AREA_MARGIN, TRAINED: AREA_MARGIN}
"""Equivalence margins of measures whose margin is not `DEFAULT_MARGIN`."""

QUANTITIES = {
    HEADLINE: "Mastered test tasks over training (%)",
    FINAL: "Mastered test tasks, last three evaluations (%)",
    PAPERS: "Mastered test tasks, last evaluation (%)",
}
"""Labels of the measures on axes and above tables."""


def how_tested(family: str) -> str:
    """Return a sentence about the scale of tests and the `family` over which they are corrected."""
    return f"Tests are of what is shown, in per cent; Holm's correction covers {family}."


SHARED: Final = frozenset({SIMULATED})
"""Engines on which all runs of a seed share a student's pace of learning, so that pairing by seed helps
(`docs/statistics.md`)."""

Seeds: TypeAlias = Mapping[Hashable, Hashable]
"""Seeds of paired runs by run id; runs that are not listed are independent."""


def seeds_to_pair(*tables: pd.DataFrame) -> Seeds:
    """Return the seeds of paired runs, from tables with engine, seed and run_id."""
    seeds: dict[Hashable, Hashable] = {}
    for table in tables:
        if SHARED.isdisjoint(table["engine"].unique()):
            continue
        rows = table[table["engine"].isin(SHARED)]
        seeds |= dict(zip(rows["run_id"].astype(object), rows["seed"], strict=True))
    return seeds


def compared(sample: pd.Series, reference: pd.Series, seeds: Seeds) -> Comparison:
    """Compare the means of two samples, in pairs if all of their runs are in `seeds`, else by Welch's test.

    Args:
        sample: one value per run, indexed by run id.
        reference: values of the other sample.
        seeds: seeds from `seeds_to_pair`.
    """
    if are_paired([sample, reference], seeds):
        return paired_strata([(sample, reference)], [1.0], seeds)
    return welch(sample, reference)


def compared_over_strata(
    pairs: Sequence[tuple[pd.Series, pd.Series]],
    weights: Sequence[float],
    seeds: Seeds,
    least: Sequence[float] = (),
    described: Sequence[tuple[Description, Description]] = (),
) -> Comparison:
    """Compare the means of two groups over strata, paired by seed as in `compared`.

    Other arguments are those of `stratified`.
    """
    if are_paired([sample for pair in pairs for sample in pair], seeds):
        return paired_strata(pairs, weights, seeds)
    return stratified(pairs, weights, least, described)


def mean_over_strata(samples: Sequence[pd.Series], weights: Sequence[float], seeds: Seeds) -> Comparison:
    """Return the weighted mean over strata with its interval, as a comparison with 0.

    For paired runs the mean is over the seeds that all strata have. Arguments are those of `seed_means`.
    """
    if are_paired(samples, seeds):
        means = seed_means(samples, weights, seeds)
        return paired(means, 0.0 * means)
    zero = pd.Series([0.0, 0.0], index=["first zero", "second zero"])
    return stratified([(sample, zero) for sample in samples], weights)


def in_common(first: pd.Series, second: pd.Series, seeds: Seeds) -> tuple[pd.Series, pd.Series]:
    """Return both samples, restricted to runs with common seeds if they are paired."""
    if not are_paired([first, second], seeds):
        return first, second
    first_seeds, second_seeds = (sample.index.map(seeds) for sample in (first, second))
    return first[first_seeds.isin(second_seeds)], second[second_seeds.isin(first_seeds)]


def are_paired(samples: Sequence[pd.Series], seeds: Seeds) -> bool:
    """Return True if the samples have runs and all of these are in `seeds`."""
    runs = [run for sample in samples for run in sample.index] if seeds else []
    return bool(runs) and all(run in seeds for run in runs)


class Verdict(StrEnum):
    """Result of a test after the correction for its family.

    Attributes:
        BETTER: significant difference above 0.
        WORSE: significant difference below 0.
        ALIKE: simultaneous interval within the margin.
        OPEN: none of these.
    """

    BETTER = "better"
    WORSE = "worse"
    ALIKE = "alike"
    OPEN = "not distinguishable"


THAN: Final = {
    Verdict.BETTER: "better than",
    Verdict.WORSE: "worse than",
    Verdict.ALIKE: "alike, within the margin, with",
    Verdict.OPEN: "not distinguishable from",
}
"""Phrases of verdicts, to be followed by the name of the other teacher."""

AXES: Final = {HEADLINE: "sooner", FINAL: "in the end"}
"""Axes by which teachers are compared, by measure: mean over training, and last three evaluations."""


def verdict(test: pd.Series | Mapping[str, Any]) -> str:
    """Return the `Verdict` of a row from `pairwise.pairwise`, or the reason for no test."""
    if test["reason"]:
        return str(test["reason"])
    if test["holm"] < SIGNIFICANCE:
        return Verdict.BETTER if test["difference"] > 0 else Verdict.WORSE
    margin = MARGINS.get(test["measure"], DEFAULT_MARGIN)
    within = -margin < test["simultaneous_low"] and test["simultaneous_high"] < margin
    return Verdict.ALIKE if within else Verdict.OPEN


def on_both_axes(sooner: str, in_the_end: str) -> str:
    """Combine the verdicts on both measures into a phrase, or return the verdict if they share one.

    Args:
        sooner: verdict on the mean over training.
        in_the_end: verdict on the mean of the last three evaluations.

    Examples:
        >>> on_both_axes("better", "better"), on_both_axes("better", "alike"), on_both_axes("alike", "worse")
        ('better', 'sooner, and alike in the end', 'worse in the end only')
    """
    if sooner == in_the_end:
        return in_the_end
    when = {"better": "sooner", "worse": "later"}.get(sooner)
    decided = in_the_end in (Verdict.BETTER, Verdict.WORSE)
    if when is None:
        return f"{in_the_end} in the end only" if decided else str(Verdict.OPEN)
    return f"{when}, {'but' if decided else 'and'} {in_the_end} in the end"
