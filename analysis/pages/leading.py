"""Teachers that a page of many shows at first; readers switch the others on."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import pandas as pd

from analysis.data.reference import is_baseline

MANY = 12
"""Up to so many teachers are all shown at first."""

SHOWN = 8
"""Of more teachers so many are shown at first, beside Random."""


def leading(
    results: pd.DataFrame, measure: str, teachers: Iterable[object], within: Sequence[str] = ()
) -> frozenset[str]:
    """Returns the teachers that a page shows at first: all, or of many Random and the best.

    The best are those with the highest mean of a measure over the challenges that each has results of, and
    the best one of each comparison that would otherwise be empty.

    Args:
        results: a row for each teacher and challenge, with the columns teacher and `measure`.
        measure: column of `results`; NaN where there is nothing.
        teachers: of the page, also those without results yet.
        within: columns that the teachers of a comparison have in common.
    """
    everyone = frozenset(map(str, teachers))
    if len(everyone) <= MANY:
        return everyone
    means = results.groupby("teacher")[measure].mean().sort_values(ascending=False, kind="stable")
    others = [str(teacher) for teacher in means.index if not is_baseline(str(teacher))]
    shown = {*others[:SHOWN], *(str(each) for each in means.index if is_baseline(str(each)))}
    if within:
        best = results.dropna(subset=[measure]).sort_values(measure, ascending=False, kind="stable")
        for _, rows in best.groupby(list(within), dropna=False, sort=True):
            if shown.isdisjoint(rows["teacher"]):
                shown.add(str(rows["teacher"].iloc[0]))
    return frozenset(shown)
