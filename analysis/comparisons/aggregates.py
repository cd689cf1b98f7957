"""Interquartile means, probabilities of improvement and performance profiles of pooled runs."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.comparisons.frame import nobody, pairs_of
from analysis.data.tables import check_measure
from analysis.measures.pooling import COMPARED, CONDITIONS, PARTS, POOLED
from analysis.measures.tested import (
    MEASURES,
    Seeds,
    are_paired,
    compared_over_strata,
    in_common,
    mean_over_strata,
    scale_of,
    seeds_to_pair,
)
from analysis.statistics import Comparison, holm, percent_interval
from analysis.statistics.estimates import (
    Estimate,
    interquartile_mean_of,
    performance_profile,
    probability_of_improvement,
)
from tma_ray.arguments import check_names

ACROSS = ["expert_knowledge", *CONDITIONS]
"""Columns that runs of several challenges must have in common to be aggregated."""

PLACES = ["environment", "challenge", "pool", "test_sets"]
"""Columns that tell challenges apart."""

CHALLENGES = [*PLACES, *PARTS]
"""Columns that tell the strata of an aggregate over challenges apart."""

ESTIMATE = list(Estimate.__dataclass_fields__)


def interquartile_means(
    runs: pd.DataFrame,
    measure: str,
    by: Sequence[str] = POOLED,
    strata: Sequence[str] = PARTS,
) -> pd.DataFrame:
    """Returns the interquartile mean of each group of runs, with its interval.

    Args:
        runs: rows of `pooling.pool_runs`; those without the measure do not count, and no run counts twice.
        measure: column of `runs`.
        by: columns that a group has in common, teacher among them; ``[*ACROSS, "teacher"]`` over challenges.
        strata: columns that tell the strata of a sample apart; `CHALLENGES` over challenges.

    Returns:
        `by`, measure, value, low, high, n, reason (of `statistics.estimates.Estimate`), and missing: strata
        of other teachers in which this one has no results, in words; empty where there are none.
    """
    check_names("by", by)
    by, rows = list(by), []
    check_measure("runs", runs, measure, [*by, *strata])
    common = [column for column in by if column != "teacher"]
    seeds = seeds_to_pair(runs)
    for _, compared in _stratified(runs, measure, by, strata).groupby(common, dropna=False, sort=True):
        groups = compared.groupby(by, dropna=False, sort=True)
        samples = {key: _strata_of(group, measure) for key, group in groups}
        everywhere = {name for sample in samples.values() for name in sample}
        for key, sample in samples.items():
            estimate = interquartile_mean_of(sample, _clusters(sample, seeds))
            missing = "; ".join(sorted(everywhere - set(sample)))
            row = dict(zip(by, key, strict=True)) | {"measure": measure} | vars(estimate)
            if measure in MEASURES:
                row |= _within_percent(estimate.value, estimate.high)
            rows.append(row | {"missing": missing})
    return pd.DataFrame(rows, columns=[*by, "measure", *ESTIMATE, "missing"])


def improvements(
    runs: pd.DataFrame,
    measure: str,
    reference: str | None = None,
    within: Sequence[str] = COMPARED,
    strata: Sequence[str] = PARTS,
) -> pd.DataFrame:
    """Returns the probability that a run of one teacher beats one of another, one row a pair.

    Args:
        runs: rows of `pooling.pool_runs`.
        measure: column of `runs`.
        reference: the teacher that all others are set against; None for all pairs.
        within: columns that teachers must have in common to be compared; `ACROSS` over challenges.
        strata: columns within which runs are compared; `CHALLENGES` over challenges.

    Returns:
        `within`, measure, first, second, and value, low, high, n, reason of `statistics.estimates.Estimate`.
    """
    within, rows, seeds = list(within), [], seeds_to_pair(runs)
    counted = _counted(_stratified(runs, measure, [*within, "teacher"], strata), measure)
    for key, group in counted.groupby(within, dropna=False, sort=True):
        samples = {str(name): _strata_of(part, measure) for name, part in group.groupby("teacher")}
        for first, second in pairs_of(list(samples), reference):
            pair = _of_common_seeds(samples[first], samples.get(second, {}), seeds)
            estimate = vars(probability_of_improvement(*pair))
            if second not in samples:
                estimate |= {"reason": nobody(second)}
            names = {"measure": measure, "first": first, "second": second}
            rows.append(dict(zip(within, key, strict=True)) | names | estimate)
    return pd.DataFrame(rows, columns=[*within, "measure", "first", "second", *ESTIMATE])


def stratified_differences(
    runs: pd.DataFrame,
    measure: str,
    reference: str,
    within: Sequence[str] = ACROSS,
) -> pd.DataFrame:
    """Returns the difference of each teacher to a reference over all challenges that both have, one row each.

    Challenges have equal weight, and within a challenge its bodies and students. Tested on the scale of
    `tested.scale_of`. One family: p is adjusted for all teachers that have `within` in common.

    Args:
        runs: rows of `pooling.pool_runs`.
        measure: column of `runs`.
        reference: the teacher that all others are compared with.
        within: columns that teachers must have in common to be compared.

    Returns:
        `within`, measure, teacher, challenges (how many), fewest (runs that either teacher has of one of
        them), the columns of `statistics.Comparison`, and holm.
    """
    within, rows = list(within), []
    counted, seeds = _over_challenges(runs, measure, [*within, "teacher"]), seeds_to_pair(runs)
    for key, group in counted.groupby(within, dropna=False, sort=True):
        strata = {
            str(name): _by_challenge(part, measure) for name, part in group.groupby("teacher", sort=True)
        }
        others = strata.pop(reference, {})
        for teacher, mine in strata.items():
            challenges = [
                place for place in mine if place in others and set(mine[place]) == set(others[place])
            ]
            pairs = [
                (mine[place][part], others[place][part])
                for place in challenges
                for part in sorted(mine[place])
            ]
            weights = [1 / len(mine[place]) for place in challenges for _ in mine[place]]
            test = vars(compared_over_strata(pairs, weights, seeds, scale_of(measure)))
            if not others:
                test |= {"reason": nobody(reference)}
            fewest = min((_runs(side[place]) for side in (mine, others) for place in challenges), default=0)
            fewest = min(fewest, test["n"])  # pairs may be fewer than runs
            names = {"measure": measure, "teacher": teacher, "challenges": len(challenges), "fewest": fewest}
            rows.append(dict(zip(within, key, strict=True)) | names | test)
    columns = [*within, "measure", "teacher", "challenges", "fewest", *Comparison.__dataclass_fields__]
    table = pd.DataFrame(rows, columns=columns)
    table["holm"] = table.groupby(within, dropna=False)["p"].transform(holm) if len(table) else table["p"]
    return table


def stratified_means(runs: pd.DataFrame, measure: str, within: Sequence[str] = ACROSS) -> pd.DataFrame:
    """Returns the mean of each teacher over all challenges that it has results of, one row each.

    Weights as in `stratified_differences`. Intervals of percentages stay within 0 and 100, and are not
    symmetric.

    Args:
        runs: rows of `pooling.pool_runs`.
        measure: column of `runs`.
        within: columns that runs must have in common.

    Returns:
        `within`, measure, teacher, challenges (how many), and the columns of `statistics.Comparison` of which
        difference, low and high are the mean and its 95 % interval.
    """
    rows = []
    counted, seeds = _over_challenges(runs, measure, [*within, "teacher"]), seeds_to_pair(runs)
    for key, part in counted.groupby([*within, "teacher"], dropna=False, sort=True):
        places = _by_challenge(part, measure)
        samples = [sample for strata in places.values() for sample in strata.values()]
        weights = [1 / len(strata) for strata in places.values() for _ in strata]
        names = dict(zip([*within, "teacher"], key, strict=True))
        mean = vars(mean_over_strata(samples, weights, seeds)) | {"n": sum(map(len, samples))}
        if measure in MEASURES:
            mean |= _within_percent(mean["difference"], mean["high"])
        rows.append(names | {"measure": measure, "challenges": len(places)} | mean)
    columns = [*within, "teacher", "measure", "challenges", *Comparison.__dataclass_fields__]
    return pd.DataFrame(rows, columns=columns)


def _within_percent(mean: float, high: float) -> dict[str, float]:
    """Returns low and high of a mean percentage, of which the upper end of a symmetric interval is known."""
    return dict(zip(("low", "high"), percent_interval(mean, high - mean), strict=True))


def _by_challenge(rows: pd.DataFrame, measure: str) -> dict[Hashable, dict[str, pd.Series]]:
    """Returns the samples of each body and student by challenge."""
    return {place: _strata_of(part, measure) for place, part in rows.groupby("place", sort=True)}


def _clusters(sample: Mapping[str, pd.Series], seeds: Seeds) -> Seeds | None:
    """Returns the seeds of a sample whose runs they make depend on each other; None where they do not."""
    return seeds if are_paired(list(sample.values()), seeds) else None


def _of_common_seeds(
    first: Mapping[str, pd.Series], second: Mapping[str, pd.Series], seeds: Seeds
) -> tuple[dict[str, pd.Series], dict[str, pd.Series]]:
    """Returns both samples without the runs of paired seeds that only one of them has in a stratum."""
    parts = {name: in_common(first[name], second[name], seeds) for name in first if name in second}
    return (
        {**first, **{name: pair[0] for name, pair in parts.items()}},
        {**second, **{name: pair[1] for name, pair in parts.items()}},
    )


def _runs(strata: Mapping[str, pd.Series]) -> int:
    return sum(map(len, strata.values()))


def profiles(
    runs: pd.DataFrame,
    measure: str,
    thresholds: Sequence[float],
    by: Sequence[str] = POOLED,
    strata: Sequence[str] = PARTS,
) -> pd.DataFrame:
    """Returns the share of runs over each threshold, group by group, with intervals.

    Args:
        runs: rows of `pooling.pool_runs`.
        measure: column of `runs`.
        thresholds: values of the measure.
        by: columns that a group has in common; ``[*ACROSS, "teacher"]`` over challenges.
        strata: columns that tell the strata of a sample apart; `CHALLENGES` over challenges.

    Returns:
        `by`, measure, threshold, share, low, high, n, reason.
    """
    by, rows, seeds = list(by), [], seeds_to_pair(runs)
    for key, group in _stratified(runs, measure, by, strata).groupby(by, dropna=False, sort=True):
        sample = _strata_of(group, measure)
        profile = performance_profile(sample, thresholds, _clusters(sample, seeds))
        shared = dict(zip(by, key, strict=True)) | {"measure": measure}
        rows += [
            shared | {str(name): value for name, value in each.items()} for each in profile.to_dict("records")
        ]
    return pd.DataFrame(rows, columns=[*by, "measure", "threshold", "share", "low", "high", "n", "reason"])


def _stratified(runs: pd.DataFrame, measure: str, by: Sequence[str], strata: Sequence[str]) -> pd.DataFrame:
    """Returns `by`, run_id, the measure, and stratum and stratum_name of each row.

    Strata are numbered here, in order, rather than in each of hundreds of groups. A run that is measured
    counts once in each group.
    """
    numbers = _numbered(runs, strata)
    _, first = np.unique(numbers, return_index=True)
    names = [", ".join(map(str, key)) for key in runs[list(strata)].to_numpy(object)[first]]
    columns = list(dict.fromkeys([*by, "run_id", measure]))
    rows = runs[columns].assign(stratum=numbers, stratum_name=np.array(names, dtype=object)[numbers])
    counted = rows[measure].notna()
    return rows[~(counted & rows.assign(counted=counted).duplicated([*by, "run_id", "counted"]))]


def _over_challenges(runs: pd.DataFrame, measure: str, by: Sequence[str]) -> pd.DataFrame:
    """Returns `by`, run_id, the measure, place (challenge) and stratum in it of each run with a value."""
    runs = runs.assign(place=_numbered(runs, PLACES)).reset_index(drop=True)
    rows = _counted(_stratified(runs, measure, by, PARTS), measure)
    return rows.assign(place=runs["place"])


def _numbered(runs: pd.DataFrame, columns: Sequence[str]) -> NDArray[np.int64]:
    numbers = runs.groupby(list(columns), dropna=False, sort=True).ngroup()
    return np.asarray(numbers, dtype=np.int64)


def _counted(rows: pd.DataFrame, measure: str) -> pd.DataFrame:
    return rows[rows[measure].notna()]


def _strata_of(rows: pd.DataFrame, measure: str) -> dict[str, pd.Series]:
    """Returns the values of `measure` by stratum, named by what tells them apart, indexed by run id."""
    rows = _counted(rows, measure)
    values, run_ids = rows[measure].to_numpy(float), rows["run_id"].to_numpy(object)
    names, numbers = rows["stratum_name"].to_numpy(object), rows["stratum"].to_numpy()
    order = np.argsort(numbers, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(numbers[order])) + 1) if len(order) else []
    return {names[part[0]]: pd.Series(values[part], index=run_ids[part]) for part in parts}
