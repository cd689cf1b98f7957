"""Means, interquartile means, probabilities of improvement and performance profiles of pooled runs.

In all functions `runs` are rows from `pooling.pool_runs`, and `measure` is a column of them. Runs without it
do not count, and no run counts twice in a group. Groups are given by the columns `by`, teacher among them,
compared teachers by the columns `within`, and strata of a sample by the columns `strata`. Over challenges
these are ``[*ACROSS, "teacher"]``, `ACROSS` and `STRATA`.
"""

from collections.abc import Mapping, Sequence

import pandas as pd

from analysis.comparisons.pairwise import (
    TEST,
    by_challenge,
    nobody,
    pairs_of,
    strata_of,
    stratified_runs,
)
from analysis.data.columns import ACROSS, COMPARED, PARTS, POOLED, STRATA
from analysis.data.frames import check_measure
from analysis.measures.tested import MEASURES, Seeds, are_paired, in_common, mean_over_strata, seeds_to_pair
from analysis.statistics import percent_interval, stratum_weights
from analysis.statistics.estimates import (
    interquartile_mean_of,
    performance_profile,
    probability_of_improvement,
)
from analysis.statistics.samples import Estimate
from tma_ray.support.validation import check_sequence

ESTIMATE = list(Estimate.__dataclass_fields__)


def interquartile_means(
    runs: pd.DataFrame,
    measure: str,
    by: Sequence[str] = POOLED,
    strata: Sequence[str] = PARTS,
) -> pd.DataFrame:
    """Return the interquartile mean of each group of runs, with its interval.

    Args:
        runs: rows from `pooling.pool_runs`.
        measure: column of `runs`.
        by: columns of a group, teacher among them; ``[*ACROSS, "teacher"]`` over challenges.
        strata: columns of the strata of a sample; `STRATA` over challenges.

    Returns:
        `by`, measure, value, low, high, n, reason (of `statistics.estimates.Estimate`), and missing: strata
        in which only other teachers have results, as text.
    """
    check_sequence("by", by)
    by, rows = list(by), []
    check_measure("runs", runs, measure, [*by, *strata])
    common = [column for column in by if column != "teacher"]
    seeds = seeds_to_pair(runs)
    for _, compared in stratified_runs(runs, measure, by, strata).groupby(common, dropna=False, sort=True):
        groups = compared.groupby(by, dropna=False, sort=True)
        samples = {key: strata_of(group, measure) for key, group in groups}
        everywhere = {name for sample in samples.values() for name in sample}
        for key, sample in samples.items():
            estimate = interquartile_mean_of(sample, _clusters(sample, seeds))
            row = dict(zip(by, key, strict=True)) | {"measure": measure} | vars(estimate)
            if measure in MEASURES:
                margin = estimate.high - estimate.value
                row["low"], row["high"] = percent_interval(estimate.value, margin)
            rows.append(row | {"missing": "; ".join(sorted(everywhere - set(sample)))})
    return pd.DataFrame(rows, columns=[*by, "measure", *ESTIMATE, "missing"])


def improvements(
    runs: pd.DataFrame,
    measure: str,
    reference: str | None = None,
    within: Sequence[str] = COMPARED,
    strata: Sequence[str] = PARTS,
) -> pd.DataFrame:
    """Return, for each pair of teachers, the probability that a run of one beats a run of the other.

    Args:
        runs: rows from `pooling.pool_runs`.
        measure: column of `runs`.
        reference: teacher that all others are compared with; None for all pairs.
        within: columns that teachers must have in common to be compared; `ACROSS` over challenges.
        strata: columns within which runs are compared; `STRATA` over challenges.

    Returns:
        `within`, measure, first, second, and value, low, high, n, reason of `statistics.estimates.Estimate`.
    """
    within, rows, seeds = list(within), [], seeds_to_pair(runs)
    table = stratified_runs(runs, measure, [*within, "teacher"], strata)
    for key, group in table[table[measure].notna()].groupby(within, dropna=False, sort=True):
        samples = {str(name): strata_of(part, measure) for name, part in group.groupby("teacher")}
        for first, second in pairs_of(list(samples), reference):
            values, others = dict(samples[first]), dict(samples.get(second, {}))
            for stratum in values.keys() & others.keys():  # only paired runs with common seeds count
                values[stratum], others[stratum] = in_common(values[stratum], others[stratum], seeds)
            estimate = vars(probability_of_improvement(values, others))
            estimate |= {} if second in samples else {"reason": nobody(second)}
            rows.append([*key, measure, first, second, *(estimate[name] for name in ESTIMATE)])
    return pd.DataFrame(rows, columns=[*within, "measure", "first", "second", *ESTIMATE])


def stratified_means(runs: pd.DataFrame, measure: str, within: Sequence[str] = ACROSS) -> pd.DataFrame:
    """Return each teacher's mean over all challenges on which the teacher has runs, one row per teacher.

    Weights are those of `pairwise.over_challenges`. Intervals of percentages stay within 0 and 100.

    Returns:
        `within`, measure, teacher, challenges (number), and the columns of `statistics.Comparison`, where
        difference, low and high are the mean and its 95 % interval.
    """
    rows = []
    seeds, table = seeds_to_pair(runs), stratified_runs(runs, measure, [*within, "teacher"], STRATA)
    for key, part in table[table[measure].notna()].groupby([*within, "teacher"], dropna=False, sort=True):
        challenges = by_challenge(part, measure)
        samples = [sample for strata in challenges.values() for sample in strata.values()]
        weights = stratum_weights([key for key, strata in challenges.items() for _ in strata])
        mean = vars(mean_over_strata(samples, weights, seeds)) | {"n": sum(map(len, samples))}
        if measure in MEASURES:
            margin = mean["high"] - mean["difference"]
            mean["low"], mean["high"] = percent_interval(mean["difference"], margin)
        rows.append([*key, measure, len(challenges), *(mean[name] for name in TEST)])
    return pd.DataFrame(rows, columns=[*within, "teacher", "measure", "challenges", *TEST])


def _clusters(sample: Mapping[str, pd.Series], seeds: Seeds) -> Seeds | None:
    """Return `seeds` as the clusters of a sample if its runs are paired by seed, else None."""
    return seeds if are_paired(list(sample.values()), seeds) else None


def profiles(
    runs: pd.DataFrame,
    measure: str,
    thresholds: Sequence[float],
    by: Sequence[str] = POOLED,
    strata: Sequence[str] = PARTS,
) -> pd.DataFrame:
    """Return the performance profile of each group: the share of runs above each threshold, with intervals.

    Args:
        runs: rows from `pooling.pool_runs`.
        measure: column of `runs`.
        thresholds: values of the measure.
        by: columns of a group; ``[*ACROSS, "teacher"]`` over challenges.
        strata: columns of the strata of a sample; `STRATA` over challenges.

    Returns:
        `by`, measure, threshold, share, low, high, n, reason.
    """
    by, rows, seeds = list(by), [], seeds_to_pair(runs)
    columns = ["threshold", "share", "low", "high", "n", "reason"]
    for key, group in stratified_runs(runs, measure, by, strata).groupby(by, dropna=False, sort=True):
        sample = strata_of(group, measure)
        profile = performance_profile(sample, thresholds, _clusters(sample, seeds))
        rows += [[*key, measure, *each] for each in profile[columns].itertuples(index=False, name=None)]
    return pd.DataFrame(rows, columns=[*by, "measure", *columns])
