"""The frame of comparisons: who against whom, where, by which measure, and what the test of their means says.

Rankings, ranks, boards, pages and sentences are views of it.
"""

import itertools
import math
from collections.abc import Collection, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.data.frames import COMPARISON, GROUP, check_columns, check_measure
from analysis.data.identity import CONDITIONS as SPEC_CONDITIONS
from analysis.data.reference import BASELINE, NO_BASELINE, baseline_rows, baseline_runs, is_baseline
from analysis.measures.pooling import COMPARED, CONDITIONS, PARTS
from analysis.measures.tested import Seeds, compared, compared_over_strata, scale_of, seeds_to_pair
from analysis.statistics import (
    SIGNIFICANCE,
    Comparison,
    Description,
    Method,
    Scale,
    describe,
    holm,
    least_variance,
    welch_from_statistics,
)
from analysis.statistics.power import detectable_difference, detectable_in_pairs
from tma_ray.arguments import check_known, check_names
from tma_ray.benchmark import TEACHERS

ACROSS = ["expert_knowledge", *CONDITIONS]
"""Columns that runs of several challenges must have in common to be aggregated."""

PLACES = ["environment", "challenge", "pool", "test_sets"]
"""Columns that tell challenges apart."""

CHALLENGES = [*PLACES, *PARTS]
"""Columns that tell the strata of an aggregate over challenges apart."""

OTHER_PARTS: Final = "other bodies or students"
"""Reason why two groups are not tested whose runs are not of the same bodies and students."""

TEST = list(Comparison.__dataclass_fields__)
"""Columns of a test, those of `statistics.Comparison`."""

FRAME = ["measure", "first", "second", "challenges", "fewest", *TEST, "uncounted", "detectable"]
"""Columns of the frame besides those that groups have in common, and holm."""

APART = ("experiment", "expert_knowledge")
"""Columns that tell comparisons of a report apart and make no difference to Random."""

ALIKE = [*(column for column in COMPARISON if column not in APART), *SPEC_CONDITIONS]
"""Columns that Random must have in common with those that are tested against it."""

Randoms: TypeAlias = Mapping[Any, pd.DataFrame]


def pairwise(
    runs: pd.DataFrame,
    measure: str,
    reference: str | None = None,
    within: Sequence[str] = COMPARED,
    between: str = "teacher",
    strata: Sequence[str] = (),
    *,
    detectable: bool = True,
) -> pd.DataFrame:
    """Return the frame of comparisons between groups of runs, one row a pair.

    Tests are Welch's, or paired by seed where seeds share a student, on the scale of `tested.scale_of`. Runs
    without the measure do not count. Groups are not tested that share a run or that pool other bodies or
    students. Over challenges (``within=ACROSS, strata=CHALLENGES``) the difference is that of the challenges
    that both groups have with the same bodies and students; challenges have equal weight, and within a
    challenge its bodies and students.

    Args:
        runs: rows of `pooling.pool_runs`; with a step column among `within`, the values of
            `run_measures.evaluations_at`, and so tests along learning curves.
        measure: column of `runs`.
        reference: group that all others are tested against, such as "random"; None for all pairs.
        within: columns that groups must have in common to be compared.
        between: column that tells groups apart: teacher, or expert_knowledge (with teacher among `within`).
        strata: columns within which groups are compared, `CHALLENGES`; none for one sample a group.
        detectable: True to compute that column, which takes longer than the tests.

    Returns:
        `within`, measure, first, second (the reference, if there is one), the columns of
        `statistics.Comparison` for first minus second, and

        - challenges: number of those that are compared;
        - fewest: runs that either group has of one challenge, at least;
        - uncounted: runs of both without the measure, or not yet at the step; while there are any, the
          test is not the last word;
        - detectable: smallest difference that so many runs with these standard deviations find with power
          0.8; NaN without a test, over strata, or if it is not computed;
        - holm: p adjusted for all tests that have `within` in common, step left out, so that all pairs and
          steps of a comparison are one family.
    """
    check_names("within", within)
    check_measure("runs", runs, measure, [*within, between, *strata])
    if between == "teacher":
        _check_reference(reference, runs)
    within, rows = list(within), []
    family, seeds = [column for column in within if column != "step"], seeds_to_pair(runs)
    parts = [column for column in PARTS if column not in (*within, between)]
    members = runs.groupby([*family, between], dropna=False)["run_id"].transform("nunique")
    table = stratified_runs(runs.assign(members=members), measure, [*within, between], strata, parts)
    table = table[table["step"].notna()] if "step" in within else table
    for key, group in table.groupby(within, dropna=False, sort=True):
        shared = dict(zip(within, key, strict=True)) | {"measure": measure}
        samples = {
            str(name): _Sample.of(part, measure, parts) for name, part in group.groupby(between, sort=True)
        }
        least = _least_variances(samples.values(), scale_of(measure)) if strata else None
        for first, second in pairs_of(list(samples), reference):
            other = samples.get(second) or _Sample.of(group.head(0), measure, parts)
            row: dict[str, Any] = shared | {"first": first, "second": second}
            row |= _compared(samples[first], other, seeds, scale_of(measure), least)
            if second not in samples:
                row["reason"] = nobody(second)
            elif detectable and not strata:
                if row["method"] is Method.PAIRED:
                    margin = (row["high"] - row["low"]) / 2
                    row["detectable"] = detectable_in_pairs(row["n"], margin)
                elif not row["reason"] and row["method"] is not Method.SIGN_FLIP:
                    described = describe(samples[first].pooled), describe(other.pooled)
                    row["detectable"] = detectable_difference(*described)
            rows.append(row)
    return _with_holm(pd.DataFrame(rows, columns=[*within, *FRAME]), family)


def over_challenges(runs: pd.DataFrame, measure: str, reference: str | None = None) -> pd.DataFrame:
    """Return the frame of comparisons over all challenges that two teachers have, each of equal weight."""
    return pairwise(runs, measure, reference, ACROSS, strata=CHALLENGES, detectable=False)


def from_both_sides(tests: pd.DataFrame) -> pd.DataFrame:
    """Return each test of a frame and its mirror image with sides exchanged, under the same index."""
    exchanged = tests.assign(
        first=tests["second"],
        second=tests["first"],
        difference=-tests["difference"],
        low=-tests["high"],
        high=-tests["low"],
        n=tests["reference_n"],
        reference_n=tests["n"],
        t=-tests["t"],
    )
    return pd.concat([tests, exchanged])


def verdict(test: pd.Series | Mapping[str, Any]) -> str:
    """Return the result of a test in a word or two, after Holm, or the reason why there was none."""
    if test["reason"]:
        return str(test["reason"])
    if not test["holm"] < SIGNIFICANCE:
        return "not distinguishable"
    return "better" if test["difference"] > 0 else "worse"


def pairwise_from_statistics(
    table: pd.DataFrame,
    measure: str = "mastered_percent",
    reference: str | None = None,
    within: Sequence[str] = (*COMPARED, "embodiments", "students"),
) -> pd.DataFrame:
    """Return the frame of comparisons between published results, by Welch's t-test.

    Of our own results prefer the runs, which also tell whether two samples share some.

    Args:
        table: one row per teacher: teacher, n, `measure` with the endings _mean and _std, and those of
            `within` that there are.
        measure: name of the measure that is compared.
        reference: teacher that all others are tested against; None for all pairs.
        within: columns that teachers must have in common to be compared; absent ones do not matter.

    Returns:
        `within`, measure, first, second, the columns of `statistics.Comparison` for first minus second, and
        holm: p adjusted for all tests that have `within` in common.
    """
    values = ["n", f"{measure}_mean", f"{measure}_std"]
    check_columns("table", table, ["teacher", *values])
    _check_reference(reference, table)
    within, rows = [column for column in within if column in table], []
    for key, group in table.groupby(within, dropna=False, sort=True) if within else [((), table)]:
        results = {
            str(teacher): Description(int(n), float(mean), float(std))
            for teacher, n, mean, std in group[["teacher", *values]].itertuples(index=False, name=None)
        }
        for first, second in pairs_of(sorted(results), reference):
            test = Comparison(results[first].n, 0, math.nan, reason=nobody(second))
            if second in results:
                test = welch_from_statistics(results[first], results[second])
            rows.append([*key, measure, first, second, *vars(test).values()])
    return _with_holm(pd.DataFrame(rows, columns=[*within, "measure", "first", "second", *TEST]), within)


def against_baseline(finals: pd.DataFrame, curves: pd.DataFrame, measure: str) -> pd.DataFrame:
    """Return the test of every teacher of a report against Random, one row each.

    Where Random was run at another level of expert knowledge or in another experiment only, those runs are
    used. While runs are under way both are read at the same step, and the difference is not tested. `finals`
    are of `final_evaluations`, `curves` of `evaluation_curves`, and `measure` is a column of both.

    Returns:
        `GROUP`, measure, step, the columns of `statistics.Comparison`, and holm by comparison.
    """
    rows, randoms = [], randoms_of(finals)
    for key, teachers in finals.groupby(COMPARISON, sort=True):
        reference = reference_of(teachers, randoms)
        for name, mine in teachers.groupby("teacher", sort=True):
            if not is_baseline(str(name)):
                step, test = _at_one_step(mine, reference, curves, measure)
                rows.append([*key, str(name), measure, step, *vars(test).values()])
    return _with_holm(pd.DataFrame(rows, columns=[*GROUP, "measure", "step", *TEST]), COMPARISON)


def along_baseline(curves: pd.DataFrame, reference: pd.DataFrame, measure: str) -> pd.DataFrame:
    """Return the test of every teacher against Random at every evaluation, with Holm's p by step.

    Args:
        curves: results of `evaluation_curves`, of one comparison.
        reference: rows of Random among them, of `reference_of`.
        measure: column of both.

    Returns:
        step, teacher, the columns of `statistics.Comparison`, and holm.
    """
    others = curves[~curves["teacher"].map(is_baseline)]
    runs = pd.concat([others, reference.assign(teacher=BASELINE)], ignore_index=True)
    tests = pairwise(runs, measure, BASELINE, ["step"], detectable=False)
    return _with_holm(tests, ["step"]).rename(columns={"first": "teacher"})[
        ["step", "teacher", *TEST, "holm"]
    ]


def _at_one_step(
    mine: pd.DataFrame, reference: pd.DataFrame, curves: pd.DataFrame, measure: str
) -> tuple[float, Comparison]:
    """Return the step at which two groups are compared, and the comparison."""
    step, reason = min(mine["step"].max(), reference["step"].max()), ""
    if reference.empty:
        reason = NO_BASELINE
    elif mine["provisional"].any() or reference["provisional"].any():
        reason = "still running"
        now = curves[curves["step"] == step].drop_duplicates("run_id")
        mine, reference = (now[now["run_id"].isin(rows["run_id"])] for rows in (mine, reference))
    elif set(mine["step"]) != set(reference["step"]):
        reason = "trained for other numbers of steps"
    first, second = (
        pd.Series(rows[measure].to_numpy(float), rows["run_id"].to_numpy(object))
        for rows in (mine, reference)
    )
    test = compared(first, second, seeds_to_pair(mine, reference), scale_of(measure))
    return step, Comparison(test.n, test.reference_n, test.difference, reason=reason) if reason else test


def randoms_of(everything: pd.DataFrame) -> Randoms:
    """Return the rows of Random by the columns `ALIKE`, of rows with `GROUP` and `CONDITIONS`."""
    return dict(list(baseline_rows(everything).groupby(ALIKE))) if len(everything) else {}


def reference_of(teachers: pd.DataFrame, randoms: Randoms) -> pd.DataFrame:
    """Return the rows of Random, of `randoms_of`, that the rows of one comparison are tested against."""
    alike = randoms.get(tuple(teachers[ALIKE].iloc[0]), teachers.head(0))
    return baseline_runs(teachers, alike, APART).drop_duplicates(["run_id", "step"])


def pairs_of(names: Sequence[str], reference: str | None) -> Iterator[tuple[str, str]]:
    """Yield each name with `reference`, or all pairs if there is none."""
    if reference is None:
        yield from itertools.combinations(names, 2)
    else:
        yield from ((name, reference) for name in names if name != reference)


def nobody(reference: str) -> str:
    """Return the message that `reference` was not run and nothing was compared with it."""
    return NO_BASELINE if is_baseline(reference) else f"no {reference} to compare with"


def _check_reference(reference: str | None, table: pd.DataFrame) -> None:
    """Refuse a reference that is neither a teacher of the table, nor one of the benchmark's."""
    if reference is not None and len(table) and not is_baseline(reference):
        check_known("teacher", reference, {*table["teacher"].astype(str), *TEACHERS}, "there are")


def stratified_runs(
    runs: pd.DataFrame, measure: str, by: Sequence[str], strata: Sequence[str], also: Sequence[str] = ()
) -> pd.DataFrame:
    """Return `by`, run_id, the measure, and place (challenge), stratum and stratum_name of each row.

    Strata, told apart by the columns `strata`, are numbered here, in order, rather than in each of hundreds
    of groups. A run that is measured counts once in each group. Columns `also`, members and step are kept.
    """
    numbers = _numbered(runs, strata)
    _, first = np.unique(numbers, return_index=True)
    names = [", ".join(map(str, key)) for key in runs[list(strata)].to_numpy(object)[first]]
    columns = list(dict.fromkeys([*by, *also, "run_id", measure, *({"members", "step"} & {*runs.columns})]))
    rows = runs[columns].assign(
        place=_numbered(runs, [column for column in strata if column in PLACES]),
        stratum=numbers,
        stratum_name=np.array(names, dtype=object)[numbers],
    )
    counted = rows[measure].notna()
    return rows[~(counted & rows.assign(counted=counted).duplicated([*by, "run_id", "counted"]))]


def strata_of(rows: pd.DataFrame, measure: str) -> dict[str, pd.Series]:
    """Return the values of `measure` by stratum, named by what tells them apart, indexed by run id.

    Rows are some of `stratified_runs`; those without the measure do not count.
    """
    return by_challenge(rows.assign(place=0), measure).get(0, {})


def by_challenge(rows: pd.DataFrame, measure: str) -> dict[Hashable, dict[str, pd.Series]]:
    """Return the samples of each body and student by challenge, of rows of `stratified_runs`."""
    counted = rows[measure].notna().to_numpy()
    values, run_ids = rows[measure].to_numpy(float)[counted], rows["run_id"].to_numpy(object)[counted]
    names, strata, places = (
        rows[column].to_numpy()[counted] for column in ("stratum_name", "stratum", "place")
    )
    order = np.lexsort((strata, places))
    changes = np.diff(strata[order]).astype(bool) | np.diff(places[order]).astype(bool)
    samples: dict[Hashable, dict[str, pd.Series]] = {}
    for part in np.split(order, np.flatnonzero(changes) + 1) if len(order) else ():
        sample = pd.Series(values[part], index=pd.Index(run_ids[part], dtype=object))
        samples.setdefault(int(places[part[0]]), {})[names[part[0]]] = sample
    return samples


def _numbered(runs: pd.DataFrame, columns: Sequence[str]) -> NDArray[np.int64]:
    if not columns:
        return np.zeros(len(runs), np.int64)
    return np.asarray(runs.groupby(list(columns), dropna=False, sort=True).ngroup(), dtype=np.int64)


def _with_holm(table: pd.DataFrame, family: Sequence[str]) -> pd.DataFrame:
    """Return a table of tests with p adjusted for those that have the columns `family` in common."""
    groups = table.groupby(list(family), dropna=False)["p"] if family and len(table) else None
    return table.assign(holm=holm(table["p"]) if groups is None else groups.transform(holm))


@dataclass(frozen=True, eq=False)
class _Sample:
    """A group of runs.

    Attributes:
        places: values by run id, by challenge and stratum in it.
        pooled: values of all runs as one sample.
        parts: bodies and students of the runs.
        uncounted: number of runs without a value.
    """

    places: Mapping[Hashable, Mapping[str, pd.Series]]
    pooled: pd.Series
    parts: frozenset[tuple[object, ...]]
    uncounted: int

    @classmethod
    def of(cls, rows: pd.DataFrame, measure: str, parts: Sequence[str]) -> "_Sample":
        there = rows[rows[measure].notna()]
        values = pd.Series(there[measure].to_numpy(float), index=there["run_id"].to_numpy(object))
        columns = [there[column].to_numpy(object) for column in parts]
        uncounted = int(rows["members"].max()) - len(values) if len(rows) else 0
        return cls(by_challenge(there, measure), values, frozenset(zip(*columns, strict=True)), uncounted)


def _least_variances(samples: Collection[_Sample], scale: Scale) -> dict[tuple[Hashable, str], float]:
    """Return the least variance that counts in each stratum, by challenge and name, on a scale."""
    values: dict[tuple[Hashable, str], list[pd.Series]] = {}
    for place, own in itertools.chain.from_iterable(sample.places.items() for sample in samples):
        for stratum, sample in own.items():
            values.setdefault((place, stratum), []).append(scale.of(sample))
    return {name: least_variance(there) for name, there in values.items()}


def _compared(
    first: _Sample,
    second: _Sample,
    seeds: Seeds,
    scale: Scale,
    least: Mapping[tuple[Hashable, str], float] | None,
) -> dict[str, object]:
    """Return the test of two groups, over the strata of `least` or of two samples, and its scope."""
    mine, theirs = first.places, second.places
    places = [place for place in mine if place in theirs and set(mine[place]) == set(theirs[place])]
    if least is not None:
        names = [(place, stratum) for place in places for stratum in sorted(mine[place])]
        pairs = [(mine[place][stratum], theirs[place][stratum]) for place, stratum in names]
        weights = [1 / len(mine[place]) for place, _ in names]
        test = compared_over_strata(pairs, weights, seeds, scale, [least[name] for name in names])
    else:
        test = compared(first.pooled, second.pooled, seeds, scale)
        if not test.reason and first.parts != second.parts:
            sizes = len(first.pooled), len(second.pooled)
            test = Comparison(*sizes, test.difference, reason=OTHER_PARTS)
    counts = [sum(map(len, side[place].values())) for side in (mine, theirs) for place in places]
    fewest = min(min(counts, default=0), test.n)  # pairs may be fewer than runs
    uncounted = first.uncounted + second.uncounted
    own = {"challenges": len(places), "fewest": fewest, "uncounted": uncounted, "detectable": math.nan}
    return own | vars(test)
