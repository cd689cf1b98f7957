"""Checks of the tables that functions of `analysis` are given."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from tma_ray.commands.arguments import check_kind, check_known, check_names

MADE_BY = "a table, as from analysis.runs_after(frames)"


def check_columns(name: str, table: object, columns: Sequence[str]) -> None:
    """Refuses what is not a table with these columns.

    Args:
        name: of the argument.
        table: its value.
        columns: that it needs.

    Raises:
        TypeError: it is not a table, or `columns` is one text.
        ValueError: it lacks a column; the message holds the nearest one.
    """
    check_kind(name, table, pd.DataFrame, MADE_BY)
    check_names("columns", columns)
    assert isinstance(table, pd.DataFrame)
    for column in columns:
        check_known("column", column, table.columns, f"{name} has")


def check_measure(name: str, table: object, measure: str, columns: Sequence[str]) -> None:
    """Refuses what is not a table with `columns` and the numbers of a `measure`.

    Raises:
        TypeError: as of `check_columns`.
        ValueError: it lacks a column, or `measure` is none of numbers.
    """
    check_columns(name, table, [measure, *columns])
    assert isinstance(table, pd.DataFrame)
    values = table[measure].dropna()
    if len(values) and not pd.api.types.is_numeric_dtype(values.infer_objects()):
        raise ValueError(f"column {measure!r} is not a measure: {values.iloc[0]!r} is not a number")
