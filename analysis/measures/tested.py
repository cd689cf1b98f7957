"""Measures that teachers are compared by, and their tests, by pairs where runs share a student."""

from collections.abc import Hashable, Mapping, Sequence
from typing import Final, TypeAlias

import pandas as pd

from analysis.statistics import Comparison, Description, paired, paired_strata, stratified, welch
from analysis.statistics.samples import DEFAULT_MARGIN
from analysis.statistics.tests import seed_means
from tma_ray.results import SIMULATED

HEADLINE: Final = "mastered_area"
"""Measure that teachers are ranked by and tested on: mastered test tasks on average over the budget. It uses
the whole run, is comparable between runs of any budget, and decides most (`docs/statistics.md`)."""

FINAL: Final = "last_three"
"""Result in the end, shown next to the headline: mastered test tasks, mean of the last three evaluations."""

TRAINED: Final = "trained_area"
"""The headline per trained step: mastered test tasks on average until a number of steps that trained."""

PAPERS: Final = "mastered_percent"
"""Measure of the paper's tables and claims: test tasks mastered at the last evaluation."""

MEASURES = {HEADLINE: "over training", FINAL: "in the end", PAPERS: "last evaluation"}
"""Measures in the order in which views show them, and their heads in tables; all in per cent."""

AREA_MARGIN = DEFAULT_MARGIN / 2
"""Equivalence margin of means over training, in points: mastery grows about evenly, so its mean is half of
its end."""

MARGINS = {HEADLINE: AREA_MARGIN, TRAINED: AREA_MARGIN}
"""Equivalence margins of measures whose margin is not `DEFAULT_MARGIN`."""

QUANTITIES = {
    HEADLINE: "Mastered test tasks over training (%)",
    FINAL: "Mastered test tasks, last three evaluations (%)",
    PAPERS: "Mastered test tasks, last evaluation (%)",
}
"""Labels of the measures on axes and above tables."""


def how_tested(family: str) -> str:
    """Return the correction of tests for a `family`, in a sentence."""
    return f"Tests are of what is shown, in per cent; Holm's correction covers {family}."


SHARED: Final = frozenset({SIMULATED})
"""Engines on which all runs of a seed, on every challenge, train a student with the same pace of learning.

There the rule of `statistics.tests.pairing_helps` asks for pairs; on all others it does not
(`docs/statistics.md`).
"""

Seeds: TypeAlias = Mapping[Hashable, Hashable]
"""Seeds of runs by id, of those that are paired; runs that it lacks are independent of all others."""


def seeds_to_pair(*tables: pd.DataFrame) -> Seeds:
    """Return the seeds by which runs are paired; tables have engine, seed and run_id."""
    seeds: dict[Hashable, Hashable] = {}
    for table in tables:
        if SHARED.isdisjoint(table["engine"].unique()):
            continue
        rows = table[table["engine"].isin(SHARED)]
        seeds |= dict(zip(rows["run_id"].astype(object), rows["seed"], strict=True))
    return seeds


def compared(sample: pd.Series, reference: pd.Series, seeds: Seeds) -> Comparison:
    """Compare the means of two samples, by pairs if all of their runs are in `seeds`, else by Welch's test.

    Args:
        sample: one value a run, indexed by run id.
        reference: the same of the other group.
        seeds: seeds of `seeds_to_pair`.
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
    """Compare the means of two groups over strata, as `compared` does; arguments as of `stratified`."""
    if are_paired([sample for pair in pairs for sample in pair], seeds):
        return paired_strata(pairs, weights, seeds)
    return stratified(pairs, weights, least, described)


def mean_over_strata(samples: Sequence[pd.Series], weights: Sequence[float], seeds: Seeds) -> Comparison:
    """Return the weighted mean of the strata's means, and its interval, as the difference from 0.

    Of paired runs the mean is that of the seeds that all strata have. Arguments as of `seed_means`.
    """
    if are_paired(samples, seeds):
        means = seed_means(samples, weights, seeds)
        return paired(means, 0.0 * means)
    zero = pd.Series([0.0, 0.0], index=["first zero", "second zero"])
    return stratified([(sample, zero) for sample in samples], weights)


def in_common(first: pd.Series, second: pd.Series, seeds: Seeds) -> tuple[pd.Series, pd.Series]:
    """Return the values of both samples, of their common seeds alone if they are paired."""
    if not are_paired([first, second], seeds):
        return first, second
    mine, theirs = (sample.index.map(seeds) for sample in (first, second))
    return first[mine.isin(theirs)], second[theirs.isin(mine)]


def are_paired(samples: Sequence[pd.Series], seeds: Seeds) -> bool:
    """True if there are runs in some samples, and all of them are among `seeds`."""
    runs = [run for sample in samples for run in sample.index] if seeds else []
    return bool(runs) and all(run in seeds for run in runs)
