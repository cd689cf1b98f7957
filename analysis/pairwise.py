"""Welch's t-test between the groups of a comparison, at the end of training and along it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence

import pandas as pd

from analysis.measures import NO_BASELINE, is_baseline
from analysis.pooling import COMPARED, PARTS
from analysis.power import detectable_difference
from analysis.statistics import Comparison, describe, holm, welch

OTHER_PARTS = "other bodies or students"
"""Why two groups were not tested whose runs are not of the same bodies and students."""


def pairwise(
    runs: pd.DataFrame,
    measure: str,
    reference: str | None = None,
    within: Sequence[str] = COMPARED,
    between: str = "teacher",
) -> pd.DataFrame:
    """Returns Welch's t-test between groups of runs, one row a pair.

    Runs without the measure do not count. Groups that share a run are not tested, nor groups that pool
    other bodies or students.

    Args:
        runs: of `pooling.pool_runs`; with a step column among `within`, the values of
            `run_measures.evaluations_at`, and so tests along learning curves.
        measure: column of `runs`.
        reference: the group that all others are tested against, such as "random"; None for all pairs.
        within: columns that groups must have in common to be compared.
        between: column that tells groups apart: teacher, or expert_knowledge (with teacher among `within`).

    Returns:
        `within`, measure, first, second (the reference, if there is one), the columns of
        `statistics.Comparison` for first minus second, uncounted (runs of both without the measure: the
        test is not the last word while there are any), detectable (the smallest difference that so many
        runs with these standard deviations find with power 0.8; NaN without a test), and holm: p adjusted
        for all tests that have `within` in common, step left out, so that all pairs and steps of a
        comparison are one family.
    """
    within, rows = list(within), []
    for key, group in _groups(runs, within):
        shared = dict(zip(within, key, strict=True)) | {"measure": measure}
        samples = {str(name): part for name, part in group.groupby(between, sort=True)}
        for first, second in pairs_of(list(samples), reference):
            sample, other = (samples.get(name, group.head(0)) for name in (first, second))
            names = {"first": first, "second": second}
            row = shared | names | _compared(sample, other, measure, [*within, between])
            rows.append(row if second in samples else row | {"reason": nobody(second)})
    columns = [
        *within,
        "measure",
        "first",
        "second",
        *Comparison.__dataclass_fields__,
        "uncounted",
        "detectable",
    ]
    table = pd.DataFrame(rows, columns=columns)
    family = [column for column in within if column != "step"]
    table["holm"] = table.groupby(family, dropna=False)["p"].transform(holm) if len(table) else table["p"]
    return table


def _groups(runs: pd.DataFrame, within: list[str]) -> Iterator[tuple[tuple[object, ...], pd.DataFrame]]:
    runs = runs[runs["step"].notna()] if "step" in within else runs
    yield from runs.groupby(within, dropna=False, sort=True)


def pairs_of(names: Sequence[str], reference: str | None) -> Iterator[tuple[str, str]]:
    """Yields each name with `reference`, or all pairs if there is none."""
    if reference is None:
        yield from itertools.combinations(names, 2)
    else:
        yield from ((name, reference) for name in names if name != reference)


def _compared(
    first: pd.DataFrame, second: pd.DataFrame, measure: str, fixed: Sequence[str]
) -> dict[str, object]:
    """Returns the test of two groups, what it left out, and the difference that it could find."""
    counted = [rows[rows[measure].notna()].drop_duplicates("run_id") for rows in (first, second)]
    sample, other = (rows.set_index("run_id")[measure] for rows in counted)
    comparison, detectable = welch(sample, other), math.nan
    parts = [column for column in PARTS if column in first and column not in fixed]
    mixed = len({frozenset(rows[parts].itertuples(index=False, name=None)) for rows in counted}) > 1
    if not comparison.reason and mixed:
        comparison = Comparison(len(sample), len(other), comparison.difference, reason=OTHER_PARTS)
    if not comparison.reason:
        detectable = detectable_difference(describe(sample), describe(other))
    uncounted = sum(rows.loc[rows[measure].isna(), "run_id"].nunique() for rows in (first, second))
    return vars(comparison) | {"uncounted": uncounted, "detectable": detectable}


def nobody(reference: str) -> str:
    """Returns why nothing was compared with `reference`, which was not run."""
    return NO_BASELINE if is_baseline(reference) else f"no {reference} to compare with"
