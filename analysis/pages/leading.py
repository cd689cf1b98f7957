"""Teachers that a page of many shows at first; readers switch the others on."""

from __future__ import annotations

import pandas as pd

from analysis.data.reference import is_baseline

MANY = 12
"""Up to so many teachers are all shown at first."""

SHOWN = 8
"""Of more teachers so many are shown at first, beside Random."""


def leading(results: pd.DataFrame, measure: str) -> frozenset[str]:
    """Returns the teachers that a page shows at first: all, or of many Random and the best.

    The best are those with the highest mean of a measure over the challenges that each has results of.

    Args:
        results: a row for each teacher and challenge, with the columns teacher and `measure`.
        measure: column of `results`; NaN where there is nothing.
    """
    if results.empty:
        return frozenset()
    means = results.groupby("teacher")[measure].mean().sort_values(ascending=False, kind="stable")
    if len(means) <= MANY:
        return frozenset(map(str, means.index))
    others = [str(teacher) for teacher in means.index if not is_baseline(str(teacher))]
    return frozenset({*others[:SHOWN], *(str(each) for each in means.index if is_baseline(str(each)))})
