"""Pairwise tests between teachers or other groups of runs, with corrections for multiple testing."""

import itertools
import math
from collections.abc import Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.data.columns import (
    ACROSS,
    CHALLENGE,
    COMPARED,
    COMPARISON,
    GROUP,
    PARTS,
    RANDOM_ALIKE,
    RANDOM_APART,
    RUN_CONDITIONS,
    STRATA,
)
from analysis.data.frames import check_columns, check_measure
from analysis.data.reference import (
    BASELINE,
    NO_BASELINE,
    baseline_rows,
    baseline_runs,
    core_of,
    is_baseline,
)
from analysis.measures.tested import Seeds, compared, compared_over_strata, seeds_to_pair
from analysis.statistics import (
    Comparison,
    Description,
    Method,
    describe,
    holm,
    least_variance,
    simultaneous_intervals,
    stratum_weights,
    welch_from_statistics,
)
from analysis.statistics.power import detectable_difference, detectable_in_pairs
from analysis.statistics.tests import welch_of_values
from tma_ray.benchmark import TEACHERS
from tma_ray.support.validation import check_known, check_sequence

OTHER_PARTS: Final = "other bodies or students"
"""Reason why groups whose bodies or students differ are not tested."""

TEST = list(Comparison.__dataclass_fields__)
"""Columns of a test, those of `statistics.Comparison`."""

FRAME = ["measure", "first", "second", "family", "challenges", "fewest", *TEST, "uncounted", "detectable"]
"""Columns of `pairwise` besides the columns `within` and `CORRECTED`."""

CORE, NEWCOMERS = "core", "newcomers"
"""Families of tests between core teachers, and between newcomers. Tests of a newcomer against the core are a
family named after it."""

Randoms: TypeAlias = Mapping[Any, pd.DataFrame]


def pairwise(
    runs: pd.DataFrame,
    measure: str,
    reference: str | Collection[str] | None = None,
    within: Sequence[str] = COMPARED,
    between: str = "teacher",
    strata: Sequence[str] = PARTS,
    *,
    detectable: bool = True,
) -> pd.DataFrame:
    """Return the tests between groups of runs, one row per pair.

    Tests are Welch's, over strata with least variances where there are several, or paired by seed where seeds
    share a student. Runs without the measure do not count. Groups that share a run, or have other bodies or
    students, are not tested. Over challenges (``within=ACROSS, strata=STRATA``) the difference is
    that of the challenges that both groups have with the same bodies and students. Challenges have equal
    weight, as do bodies and students within a challenge.

    Teachers of a core (column core of the runs) are a family of their own with least variances of its own
    runs, so that no newcomer changes a verdict on them.

    Args:
        runs: rows from `pooling.pool_runs`; with a step column among `within`, the values of
            `run_measures.evaluations_at`, and so tests along learning curves.
        measure: column of `runs`.
        reference: group that all others are tested against, such as "random", or several groups, which are
            also tested against each other; None for all pairs.
        within: columns that groups must have in common to be compared.
        between: column of the groups: teacher, or expert_knowledge (with teacher among `within`).
        strata: columns of the strata of a sample; `STRATA` over challenges.
        detectable: True to compute that column, which takes longer than the tests.

    Returns:
        `within`, measure, first, second (the reference, if there is one), the columns of
        `statistics.Comparison` for first minus second, and

        - family: tests that are corrected together, `CORE`, `NEWCOMERS` or the name of a newcomer;
        - challenges: number of challenges that are compared;
        - fewest: smallest number of runs of either group in a stratum (challenge, body and student);
        - uncounted: runs of both groups without the measure, or not yet at the step; the test is provisional
          if there are any;
        - detectable: smallest difference that as many runs with these standard deviations within strata
          find with power 0.8; NaN without a test, over challenges, or if it is not computed;
        - holm: p adjusted over a family; all steps and pairs with the other `within` in common are corrected
          together;
        - simultaneous_low, simultaneous_high: ends of `statistics.simultaneous_intervals`.
    """
    check_sequence("within", within)
    check_measure("runs", runs, measure, [*within, between, *strata])
    if between == "teacher" and isinstance(reference, str):
        _check_reference(reference, runs)
    within, rows = list(within), []
    family, seeds = [column for column in within if column != "step"], seeds_to_pair(runs)
    strata = [column for column in strata if column not in (*within, between)]
    members = runs.groupby([*family, between], dropna=False)["run_id"].transform("nunique")
    table = stratified_runs(runs.assign(members=members), measure, [*within, between], strata)
    table = table[table["step"].notna()] if "step" in within else table
    for key, group in table.groupby(within, dropna=False, sort=True):
        shared = dict(zip(within, key, strict=True)) | {"measure": measure}
        samples = _samples_of(group, measure, between)
        core = core_of(group) if between == "teacher" else frozenset(samples)
        least = _least_variances(samples, core)
        for first, second in pairs_of(list(samples), reference):
            other = samples.get(second) or _Sample({}, 0)
            row: dict[str, Any] = shared | {"first": first, "second": second}
            row |= {"family": _family_of(first, second, core)} | _compared(
                samples[first], other, seeds, least
            )
            if second not in samples:
                row["reason"] = nobody(second)
            elif detectable and not row["reason"] and row["challenges"] == 1:
                row["detectable"] = _detectable(row, samples[first], other)
            rows.append(row)
    return corrected(pd.DataFrame(rows, columns=[*within, *FRAME]), [*family, "family"])


def over_challenges(
    runs: pd.DataFrame, measure: str, reference: str | Collection[str] | None = None
) -> pd.DataFrame:
    """Return the tests between teachers over all challenges that both have results on, weighted equally."""
    return pairwise(runs, measure, reference, ACROSS, strata=STRATA, detectable=False)


def from_both_sides(tests: pd.DataFrame) -> pd.DataFrame:
    """Return each test and its mirror image (first and second swapped) under the same index."""
    exchanged = tests.assign(
        first=tests["second"],
        second=tests["first"],
        difference=-tests["difference"],
        low=-tests["high"],
        high=-tests["low"],
        n=tests["reference_n"],
        reference_n=tests["n"],
        t=-tests["t"],
        simultaneous_low=-tests["simultaneous_high"],
        simultaneous_high=-tests["simultaneous_low"],
    )
    return pd.concat([tests, exchanged])


def pairwise_from_statistics(
    table: pd.DataFrame,
    measure: str = "mastered_percent",
    reference: str | None = None,
    within: Sequence[str] = (*COMPARED, "embodiments", "students"),
) -> pd.DataFrame:
    """Return the tests between published results, by Welch's t-test.

    For results with runs prefer `pairwise`, which excludes pairs that share runs.

    Args:
        table: one row per teacher: teacher, n, `measure` with the endings _mean and _std, and any of
            `within`.
        measure: name of the measure.
        reference: teacher that all others are tested against; None for all pairs.
        within: columns that teachers must have in common to be compared, if the table has them.

    Returns:
        `within`, measure, first, second, the columns of `statistics.Comparison` for first minus second, and
        `CORRECTED` for all tests with `within` in common.
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
    return corrected(pd.DataFrame(rows, columns=[*within, "measure", "first", "second", *TEST]), within)


def against_baseline(finals: pd.DataFrame, curves: pd.DataFrame, measures: Iterable[str]) -> pd.DataFrame:
    """Return the tests of every teacher in a report against Random, one row per teacher and measure.

    Random may have been run at another level of expert knowledge or in another experiment. Until runs have
    ended, both groups are read at the same step, and the difference is not tested.

    Args:
        finals: rows from `final_evaluations`.
        curves: rows from `evaluation_curves`.
        measures: columns of both.

    Returns:
        `GROUP`, measure, step, the columns of `statistics.Comparison`, and by comparison `CORRECTED`.
    """
    rows: dict[str, list[list[Any]]] = {measure: [] for measure in measures}
    seeds = seeds_to_pair(finals)
    finals = finals[[*GROUP, *RUN_CONDITIONS, "run_id", "step", "provisional", *rows]]
    randoms = randoms_of(finals)
    for key, teachers in finals.groupby(COMPARISON, sort=True):
        reference = reference_of(teachers, randoms)
        for name, runs in teachers.groupby("teacher", sort=True):
            if not is_baseline(str(name)):
                step, reason, groups = _at_one_step(runs, reference, curves)
                for measure, tests in rows.items():
                    first, second = (_sample_of(group, measure) for group in groups)
                    test = compared(first, second, seeds)
                    if reason:
                        test = Comparison(test.n, test.reference_n, test.difference, reason=reason)
                    tests.append([*key, str(name), measure, step, *vars(test).values()])
    columns = [*GROUP, "measure", "step", *TEST]
    tables = [corrected(pd.DataFrame(tests, columns=columns), COMPARISON) for tests in rows.values()]
    return pd.concat(tables, ignore_index=True)


def along_baseline(curves: pd.DataFrame, reference: pd.DataFrame, measure: str) -> pd.DataFrame:
    """Return the tests of all teachers against Random at every evaluation, with Holm's correction per step.

    Args:
        curves: results from `evaluation_curves`, of one comparison.
        reference: rows of Random among them, from `reference_of`.
        measure: column of both.

    Returns:
        step, teacher, measure, the columns of `statistics.Comparison`, and `CORRECTED`.
    """
    seeds = seeds_to_pair(curves, reference)
    others = _samples_at_steps(curves[~curves["teacher"].map(is_baseline)], measure)
    randoms = _samples_at_steps(reference.assign(teacher=BASELINE), measure)
    rows = []
    for step, teacher in sorted(others):
        values, run_ids = others[step, teacher]
        test = Comparison(len(values), 0, math.nan, reason=NO_BASELINE)
        if (step, BASELINE) in randoms:
            random, random_ids = randoms[step, BASELINE]
            if seeds:
                test = compared(pd.Series(values, run_ids), pd.Series(random, random_ids), seeds)
            else:
                test = welch_of_values(values, random)
        rows.append([step, teacher, measure, *vars(test).values()])
    return corrected(pd.DataFrame(rows, columns=["step", "teacher", "measure", *TEST]), ["step"])


def _samples_at_steps(
    curves: pd.DataFrame, measure: str
) -> dict[tuple[int, str], tuple[NDArray[np.float64], NDArray[np.object_]]]:
    """Return the values (n,) of `measure` and their run ids (n,), by step and teacher."""
    rows = curves[curves[measure].notna()].drop_duplicates(["step", "teacher", "run_id"])
    values, run_ids = rows[measure].to_numpy(float), rows["run_id"].to_numpy(object)
    groups: dict[Any, Any] = rows.groupby(["step", "teacher"]).indices
    return {key: (values[indices], run_ids[indices]) for key, indices in groups.items()}


def _at_one_step(
    runs: pd.DataFrame, reference: pd.DataFrame, curves: pd.DataFrame
) -> tuple[float, str, tuple[pd.DataFrame, pd.DataFrame]]:
    """Return the step at which to compare, any reason for not testing, and the rows of both groups."""
    step = min(runs["step"].max(), reference["step"].max())
    if reference.empty:
        return step, NO_BASELINE, (runs, reference)
    if runs["provisional"].any() or reference["provisional"].any():
        now = curves[curves["step"] == step].drop_duplicates("run_id")
        first, second = (now[now["run_id"].isin(rows["run_id"])] for rows in (runs, reference))
        return step, "still running", (first, second)
    same = set(runs["step"]) == set(reference["step"])
    return step, "" if same else "trained for other numbers of steps", (runs, reference)


def _sample_of(rows: pd.DataFrame, measure: str) -> pd.Series:
    """Return the values of `measure`, indexed by run id."""
    # object dtype, lest pandas convert the strings to Arrow strings
    run_ids = pd.Index(rows["run_id"].to_numpy(object), dtype=object)
    return pd.Series(rows[measure].to_numpy(float), run_ids)


def randoms_of(rows: pd.DataFrame) -> Randoms:
    """Return the rows of Random, grouped by the columns `RANDOM_ALIKE`."""
    return dict(list(baseline_rows(rows).groupby(RANDOM_ALIKE))) if len(rows) else {}


def reference_of(teachers: pd.DataFrame, randoms: Randoms) -> pd.DataFrame:
    """Return the rows of Random against which the teachers of one comparison are tested."""
    alike = randoms.get(tuple(teachers[RANDOM_ALIKE].iloc[0]), teachers.head(0))
    return baseline_runs(teachers, alike, RANDOM_APART).drop_duplicates(["run_id", "step"])


def pairs_of(names: Sequence[str], reference: str | Collection[str] | None) -> Iterator[tuple[str, str]]:
    """Yield the pairs of names that include a `reference` (one name or several), or all pairs if None."""
    if not isinstance(reference, str):
        pairs = itertools.combinations(names, 2)
        yield from (pair for pair in pairs if reference is None or not set(pair).isdisjoint(reference))
    else:
        yield from ((name, reference) for name in names if name != reference)


def nobody(reference: str) -> str:
    """Return the reason why there is no test against a `reference` without runs."""
    return NO_BASELINE if is_baseline(reference) else f"no {reference} to compare with"


def _check_reference(reference: str | None, table: pd.DataFrame) -> None:
    """Check that a reference is a teacher of the table or of the benchmark."""
    if reference is not None and len(table) and not is_baseline(reference):
        check_known("teacher", reference, {*table["teacher"].astype(str), *TEACHERS}, "there are")


def stratified_runs(
    runs: pd.DataFrame, measure: str, by: Sequence[str], strata: Sequence[str]
) -> pd.DataFrame:
    """Return runs with the columns `by`, run_id, `measure`, challenge_number, stratum and stratum_name.

    Strata, given by the columns `strata`, are numbered once rather than in each of hundreds of groups. A run
    with the measure counts once in each group. Columns members, core and step are kept.
    """
    numbers = _numbered(runs, strata)
    _, first = np.unique(numbers, return_index=True)
    names = [", ".join(map(str, key)) for key in runs[list(strata)].to_numpy(object)[first]]
    kept = [column for column in ("members", "core", "step") if column in runs]
    columns = list(dict.fromkeys([*by, "run_id", measure, *kept]))
    rows = runs[columns].assign(
        challenge_number=_numbered(runs, [column for column in strata if column in CHALLENGE]),
        stratum=numbers,
        stratum_name=np.array(names, dtype=object)[numbers],
    )
    counted = rows[measure].notna()
    return rows[~(counted & rows.assign(counted=counted).duplicated([*by, "run_id", "counted"]))]


def strata_of(rows: pd.DataFrame, measure: str) -> dict[str, pd.Series]:
    """Return the sample of each stratum by its name: values of `measure`, indexed by run id.

    Args:
        rows: rows from `stratified_runs`; those without the measure do not count.
        measure: column of `rows`.
    """
    return by_challenge(rows.assign(challenge_number=0), measure).get(0, {})


def by_challenge(rows: pd.DataFrame, measure: str) -> dict[Hashable, dict[str, pd.Series]]:
    """Return the samples (values by run id) of each challenge and stratum in rows of `stratified_runs`."""
    return _by_group(rows, measure, np.zeros(len(rows), np.int64)).get(0, {})


def _by_group(
    rows: pd.DataFrame, measure: str, groups: NDArray[np.int64]
) -> dict[int, dict[Hashable, dict[str, pd.Series]]]:
    """Return the result of `by_challenge` for each group with values, given each row's group number (n,)."""
    columns = ("stratum_name", "stratum", "challenge_number")
    names, strata, challenges = (rows[column].to_numpy() for column in columns)
    measured = np.flatnonzero(rows[measure].notna().to_numpy())
    order = measured[np.lexsort((strata[measured], challenges[measured], groups[measured]))]
    values, run_ids = rows[measure].to_numpy(float)[order], rows["run_id"].to_numpy(object)[order]
    whole = pd.Series(values, index=pd.Index(run_ids, dtype=object))
    changes = np.any([np.diff(codes[order]) != 0 for codes in (strata, challenges, groups)], axis=0)
    starts = [0, *(np.flatnonzero(changes) + 1), len(order)] if len(order) else []
    samples: dict[int, dict[Hashable, dict[str, pd.Series]]] = {}
    for start, end in itertools.pairwise(starts):
        first = order[start]
        of_group = samples.setdefault(int(groups[first]), {})
        of_group.setdefault(int(challenges[first]), {})[names[first]] = whole.iloc[start:end]
    return samples


def _numbered(runs: pd.DataFrame, columns: Sequence[str]) -> NDArray[np.int64]:
    if not columns:
        return np.zeros(len(runs), np.int64)
    return np.asarray(runs.groupby(list(columns), dropna=False, sort=True).ngroup(), dtype=np.int64)


CORRECTED = ["holm", "simultaneous_low", "simultaneous_high"]
"""Columns of Holm's correction and of the simultaneous intervals."""


def corrected(table: pd.DataFrame, family: Sequence[str]) -> pd.DataFrame:
    """Add the columns `CORRECTED` to `table`, treating tests with equal values of `family` as one family."""
    groups = table.groupby(list(family), dropna=False).indices.values() if family else [np.arange(len(table))]
    columns = ["difference", "low", "high", "degrees_of_freedom"]
    numbers, p_values = table[columns].to_numpy(float), table["p"].to_numpy(float)
    corrections = np.full((len(table), len(CORRECTED)), math.nan)
    for rows in groups:
        adjusted = holm(p_values[rows])
        difference, low, high, freedom = numbers[rows].T
        intervals = simultaneous_intervals(difference, low, high, freedom, adjusted)
        corrections[rows] = np.column_stack([adjusted, *intervals])
    return table.assign(**dict(zip(CORRECTED, corrections.T, strict=True)))


def _family_of(first: str, second: str, core: frozenset[str]) -> str:
    """Return the family of a test: `CORE`, `NEWCOMERS` or the name of a newcomer."""
    newcomers = [name for name in (first, second) if name not in core]
    return NEWCOMERS if len(newcomers) > 1 else newcomers[0] if newcomers else CORE


@dataclass(frozen=True, eq=False)
class _Sample:
    """Measured values of a group of runs."""

    challenges: Mapping[Hashable, Mapping[str, pd.Series]]  # values by challenge, then stratum, then run id
    uncounted: int  # number of runs without a value

    @cached_property
    def parts(self) -> dict[tuple[Hashable, str], Description]:
        """Size, mean and standard deviation of each stratum, by challenge and name."""
        return {
            (challenge, stratum): describe(sample)
            for challenge, strata in self.challenges.items()
            for stratum, sample in strata.items()
        }

    @property
    def n(self) -> int:
        """Number of runs with a value."""
        return sum(part.n for part in self.parts.values())

    @property
    def described(self) -> Description:
        """Number of runs, and their standard deviation within strata as if strata were of equal size."""
        std = math.sqrt(sum(part.std**2 for part in self.parts.values()) / len(self.parts))
        return Description(self.n, math.nan, std)


def _samples_of(rows: pd.DataFrame, measure: str, between: str) -> dict[str, _Sample]:
    """Return the samples of the groups in column `between`, sorted by name."""
    groups, names = pd.factorize(rows[between], sort=True)
    challenges = _by_group(rows, measure, groups)
    counts = np.bincount(groups, rows[measure].notna().to_numpy(), len(names))
    members = np.zeros(len(names), np.int64)
    np.maximum.at(members, groups, rows["members"].to_numpy())
    return {
        str(name): _Sample(challenges.get(number, {}), int(members[number] - counts[number]))
        for number, name in enumerate(names)
    }


def _detectable(row: Mapping[str, Any], first: _Sample, second: _Sample) -> float:
    """Return the smallest detectable difference between two samples; see `pairwise`."""
    if row["method"] is Method.PAIRED:
        return detectable_in_pairs(row["n"], (row["high"] - row["low"]) / 2)
    if row["method"] is Method.SIGN_FLIP:
        return math.nan
    return detectable_difference(first.described, second.described)


def _least_variances(
    samples: Mapping[str, _Sample], core: Collection[str]
) -> dict[tuple[Hashable, str], float]:
    """Return the `least_variance` of each stratum, over the core teachers in it, or all if it has none."""
    values: dict[tuple[Hashable, str], dict[bool, list[Description]]] = {}
    for name, sample in samples.items():
        for stratum, part in sample.parts.items():
            values.setdefault(stratum, {}).setdefault(name in core, []).append(part)
    return {stratum: least_variance(parts.get(True) or parts[False]) for stratum, parts in values.items()}


def _compared(
    first: _Sample, second: _Sample, seeds: Seeds, least: Mapping[tuple[Hashable, str], float]
) -> dict[str, object]:
    """Test two groups over the challenges on which both have the same strata, and return a row of results."""
    ours, others = first.challenges, second.challenges
    common = [key for key in ours if key in others and set(ours[key]) == set(others[key])]
    names = [(key, stratum) for key in common for stratum in sorted(ours[key])]
    pairs = [(ours[key][stratum], others[key][stratum]) for key, stratum in names]
    if not pairs:
        reason = OTHER_PARTS if ours.keys() & others.keys() else "nothing in common"
        test = Comparison(first.n, second.n, math.nan, reason=reason)
    elif len(pairs) == 1:
        test = compared(*pairs[0], seeds)
    else:
        weights = stratum_weights([key for key, _ in names])
        described = [(first.parts[name], second.parts[name]) for name in names]
        test = compared_over_strata(pairs, weights, seeds, [least[name] for name in names], described)
    counts = [len(runs) for strata in (ours, others) for key in common for runs in strata[key].values()]
    fewest = min(min(counts, default=0), test.n)  # test.n counts pairs, which may be fewer than runs
    uncounted = first.uncounted + second.uncounted
    scope = {"challenges": len(common), "fewest": fewest, "uncounted": uncounted, "detectable": math.nan}
    return scope | vars(test)
