"""Tests between the groups of a comparison, at the end of training and along it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import pandas as pd

from analysis.data.arguments import check_measure
from analysis.data.reference import NO_BASELINE, is_baseline
from analysis.measures.pooling import COMPARED, PARTS
from analysis.measures.shared_students import Seeds, compared, seeds_to_pair
from analysis.measures.tested import scale_of
from analysis.statistics import Comparison, Method, Scale, describe, holm
from analysis.statistics.power import detectable_difference, detectable_in_pairs
from tma_ray.benchmark import TEACHERS
from tma_ray.commands.arguments import check_known, check_names

OTHER_PARTS = "other bodies or students"
"""Why two groups were not tested whose runs are not of the same bodies and students."""

OWN = ["measure", "first", "second", *Comparison.__dataclass_fields__, "uncounted", "detectable"]
"""Columns of `pairwise` besides those that groups have in common, and holm."""


def pairwise(
    runs: pd.DataFrame,
    measure: str,
    reference: str | None = None,
    within: Sequence[str] = COMPARED,
    between: str = "teacher",
    *,
    detectable: bool = True,
) -> pd.DataFrame:
    """Returns the tests between groups of runs, one row a pair.

    Welch's, or paired by seed where seeds share a student, on the scale of `tested.scale_of`. Runs without
    the measure do not count. Groups are not tested that share a run or that pool other bodies or students.

    Args:
        runs: rows of `pooling.pool_runs`; with a step column among `within`, the values of
            `run_measures.evaluations_at`, and so tests along learning curves.
        measure: column of `runs`.
        reference: the group that all others are tested against, such as "random"; None for all pairs.
        within: columns that groups must have in common to be compared.
        between: column that tells groups apart: teacher, or expert_knowledge (with teacher among `within`).
        detectable: whether that is computed, which takes longer than the tests.

    Returns:
        `within`, measure, first, second (the reference, if there is one), the columns of
        `statistics.Comparison` for first minus second, and

        - uncounted: runs of both without the measure, or not yet at the step; while there are any, the
          test is not the last word;
        - detectable: smallest difference that so many runs with these standard deviations find with power
          0.8; NaN without a test, or if it is not computed;
        - holm: p adjusted for all tests that have `within` in common, step left out, so that all pairs and
          steps of a comparison are one family.
    """
    _check(runs, measure, reference, within, between)
    within, rows = list(within), []
    parts = [column for column in PARTS if column not in (*within, between)]
    family, seeds = [column for column in within if column != "step"], seeds_to_pair(runs)
    for key, group in _groups(_counted(runs, [*family, between]), within):
        shared = dict(zip(within, key, strict=True)) | {"measure": measure}
        named = group.groupby(between, sort=True)
        samples = {str(name): _sample(part, measure, parts) for name, part in named}
        for first, second in pairs_of(list(samples), reference):
            other = samples.get(second) or _sample(group.head(0), measure, parts)
            row = shared | {"first": first, "second": second}
            row |= _compared(samples[first], other, seeds, scale_of(measure), detectable=detectable)
            rows.append(row if second in samples else row | {"reason": nobody(second)})
    table = pd.DataFrame(rows, columns=[*within, *OWN])
    table["holm"] = table.groupby(family, dropna=False)["p"].transform(holm) if len(table) else table["p"]
    return table


def _counted(runs: pd.DataFrame, keys: list[str]) -> pd.DataFrame:
    """Returns `runs` with the number of runs that have these columns in common."""
    return runs.assign(members=runs.groupby(keys, dropna=False)["run_id"].transform("nunique"))


def _groups(runs: pd.DataFrame, within: list[str]) -> Iterator[tuple[tuple[object, ...], pd.DataFrame]]:
    runs = runs[runs["step"].notna()] if "step" in within else runs
    yield from runs.groupby(within, dropna=False, sort=True)


def pairs_of(names: Sequence[str], reference: str | None) -> Iterator[tuple[str, str]]:
    """Yields each name with `reference`, or all pairs if there is none."""
    if reference is None:
        yield from itertools.combinations(names, 2)
    else:
        yield from ((name, reference) for name in names if name != reference)


@dataclass(frozen=True, eq=False)
class _Sample:
    """A group of runs: its values by run id, its bodies and students, and how many runs have no value."""

    values: pd.Series
    parts: frozenset[tuple[object, ...]]
    uncounted: int


def _sample(rows: pd.DataFrame, measure: str, parts: Sequence[str]) -> _Sample:
    rows = rows.drop_duplicates("run_id")
    there = rows[measure].notna().to_numpy()
    values = pd.Series(rows[measure].to_numpy(float)[there], index=rows["run_id"].to_numpy(object)[there])
    columns = [rows[column].to_numpy(object)[there] for column in parts]
    uncounted = int(rows["members"].max()) - len(values) if len(rows) else 0
    return _Sample(values, frozenset(zip(*columns, strict=True)), uncounted)


def _compared(
    first: _Sample, second: _Sample, seeds: Seeds, scale: Scale, *, detectable: bool
) -> dict[str, object]:
    """Returns the test of two groups, what it left out, and the difference that it could find."""
    comparison = compared(first.values, second.values, seeds, scale)
    if not comparison.reason and first.parts != second.parts:
        sizes = len(first.values), len(second.values)
        comparison = Comparison(*sizes, comparison.difference, reason=OTHER_PARTS)
    smallest = _detectable(comparison, first, second) if detectable else math.nan
    uncounted = first.uncounted + second.uncounted
    return vars(comparison) | {"uncounted": uncounted, "detectable": smallest}


def _detectable(comparison: Comparison, first: _Sample, second: _Sample) -> float:
    if comparison.reason or comparison.method is Method.SIGN_FLIP:
        return math.nan
    if comparison.method is Method.PAIRED:
        return detectable_in_pairs(comparison.n, (comparison.high - comparison.low) / 2)
    return detectable_difference(describe(first.values), describe(second.values))


def check_reference(reference: str | None, table: pd.DataFrame) -> None:
    """Refuses a reference that is neither a teacher of the table, nor one of the benchmark's.

    Raises:
        ValueError: the message holds the nearest teacher.
    """
    if reference is not None and len(table) and not is_baseline(reference):
        check_known("teacher", reference, {*table["teacher"].astype(str), *TEACHERS}, "there are")


def _check(
    runs: pd.DataFrame, measure: str, reference: str | None, within: Sequence[str], between: str
) -> None:
    check_names("within", within)
    check_measure("runs", runs, measure, [*within, between])
    if between == "teacher":
        check_reference(reference, runs)


def nobody(reference: str) -> str:
    """Returns why nothing was compared with `reference`, which was not run."""
    return NO_BASELINE if is_baseline(reference) else f"no {reference} to compare with"
