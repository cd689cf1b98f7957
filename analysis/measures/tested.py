"""Measures that teachers are compared by, and their tests: scale, and pairs of runs that share a student."""

from collections.abc import Hashable, Mapping, Sequence
from typing import Final, TypeAlias

import pandas as pd

from analysis.statistics import Comparison, Scale, paired, paired_strata, stratified, tested_on, welch
from analysis.statistics.tests import seed_means
from tma_ray.results import SIMULATED

HEADLINE: Final = "mastered_area"
"""Measure that teachers are ranked by and tested on: mastered test tasks on average over the budget. It uses
the whole run, is comparable between runs of any budget, and decides most (`docs/statistics.md`)."""

FINAL: Final = "last_three"
"""Result in the end, shown next to the headline: mastered test tasks, mean of the last three evaluations."""

PAPERS: Final = "mastered_percent"
"""Measure of the paper's tables and claims: test tasks mastered at the last evaluation."""

MEASURES = {HEADLINE: "over training", FINAL: "last three", PAPERS: "last"}
"""Measures in the order in which views show them, and their heads in tables; all in per cent."""

QUANTITIES = {
    HEADLINE: "Mastered test tasks over training (%)",
    FINAL: "Mastered test tasks, last three evaluations (%)",
    PAPERS: "Mastered test tasks, last evaluation (%)",
}
"""Labels of the measures on axes and above tables."""


def scale_of(measure: str) -> Scale:
    """Return the scale on which means of a measure are tested.

    The spread of an area grows with its mean, and does not on the arcsine scale; that of single evaluations
    does not grow, so that they are tested in per cent (`docs/statistics.md`).
    """
    return Scale.ARCSINE if measure == HEADLINE else Scale.PERCENT


def how_tested(measure: str, family: str) -> str:
    """Return the scale of the tests of a measure and the `family` of their correction, in a sentence."""
    scale = "on the arcsine scale" if scale_of(measure) is Scale.ARCSINE else "in per cent"
    return (
        f"Tested {scale}; Holm's correction covers {family}, so that a verdict can change when a teacher is "
        f"added."
    )


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
        rows = table[table["engine"].isin(SHARED)]
        seeds |= dict(zip(rows["run_id"].astype(object), rows["seed"], strict=True))
    return seeds


def compared(
    sample: pd.Series, reference: pd.Series, seeds: Seeds, scale: Scale = Scale.PERCENT
) -> Comparison:
    """Compare the means of two samples, by pairs if all of their runs are in `seeds`, else by Welch's test.

    Args:
        sample: one value a run, indexed by run id.
        reference: the same of the other group.
        seeds: seeds of `seeds_to_pair`.
        scale: scale on which the means are tested, of `tested.scale_of`; the difference is of the values.
    """
    if scale is not Scale.PERCENT:
        scaled = compared(scale.of(sample), scale.of(reference), seeds)
        return tested_on(scaled, compared(sample, reference, seeds))
    if are_paired([sample, reference], seeds):
        return paired_strata([(sample, reference)], [1.0], seeds)
    return welch(sample, reference)


def compared_over_strata(
    pairs: Sequence[tuple[pd.Series, pd.Series]],
    weights: Sequence[float],
    seeds: Seeds,
    scale: Scale = Scale.PERCENT,
    least: Sequence[float] = (),
) -> Comparison:
    """Compare the means of two groups over strata, as `compared` does; arguments as of `stratified`.

    Least variances are those on `scale`, on which the means are tested.
    """
    if scale is not Scale.PERCENT:
        scaled = [(scale.of(first), scale.of(second)) for first, second in pairs]
        test = compared_over_strata(scaled, weights, seeds, least=least)
        return tested_on(test, compared_over_strata(pairs, weights, seeds))
    if are_paired([sample for pair in pairs for sample in pair], seeds):
        return paired_strata(pairs, weights, seeds)
    return stratified(pairs, weights, least)


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
