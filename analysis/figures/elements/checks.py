"""Checks of the tables that figures are drawn from."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from analysis.statistics import SIGNIFICANCE


def require(table: pd.DataFrame, columns: Sequence[str], what: str) -> None:
    """Checks that a table has rows and columns.

    Raises:
        ValueError: it has no rows, or lacks one of `columns`.
    """
    absent = [column for column in columns if column not in table]
    if absent:
        raise ValueError(f"{what}: expected the columns {', '.join(columns)}; {', '.join(absent)} not there")
    if table.empty:
        raise ValueError(f"expected {what} with at least one row: there is nothing to draw")


def require_unique(table: pd.DataFrame, keys: Sequence[str], what: str) -> None:
    """Checks that no two rows claim the same place in a figure.

    Raises:
        ValueError: two rows have the same `keys`.
    """
    twice = table[table.duplicated(list(keys))]
    if len(twice):
        place = ", ".join(str(value) for value in twice.iloc[0][list(keys)])
        raise ValueError(
            f"{what}: expected one row for each {', '.join(keys)}, found several of {place}; select one "
            f"of the experiments, steps, bodies or students that are mixed there"
        )


def significant(tests: pd.DataFrame) -> pd.DataFrame:
    """Returns the rows of `tests` with a p-value under 0.05 after Holm's correction; NaN is none."""
    return tests[tests["holm"] < SIGNIFICANCE]
