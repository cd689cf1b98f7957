"""Conditions that keep results apart in every view, and how they are said."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import pandas as pd

from analysis.formatting import amount

CONDITIONS = ["steps", "engine", "physics_version", "mastery_threshold", "variant"]
"""Columns of pools that results must have in common to be counted, drawn or aggregated together."""

NOT_BEGUN = "not begun"


def varying(table: pd.DataFrame, columns: Sequence[str] = CONDITIONS) -> list[str]:
    """Returns those of `columns` that have several values in `table`."""
    return [column for column in columns if table[column].nunique(dropna=False) > 1]


def condition_words(row: pd.Series, columns: Sequence[str] = CONDITIONS) -> list[str]:
    """Returns the conditions of a result in words, those in `columns`; nothing of the paper's own variant."""
    said = []
    for column in columns:
        value = row[column]
        if column in {"variant", "engine"}:
            said += [str(value)] if value else []
        elif pd.isna(value):
            said.append(NOT_BEGUN)
        elif column == "steps":
            said.append(f"{amount(value)} steps")
        elif column == "mastery_threshold":
            said.append(f"mastered over {value:g}")
        else:
            said.append(f"{column.replace('_', ' ')} {value:g}")
    return list(dict.fromkeys(said))


def by_conditions(runs: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yields the runs of each set of conditions, and a tag for names of files; the most runs first.

    Args:
        runs: rows of `pooling.pool_runs`; runs that have not begun, of no budget yet, belong to none.
    """
    begun = runs[runs["steps"].notna()]
    told = varying(begun)
    groups = [rows for _, rows in begun.groupby(CONDITIONS, dropna=False, sort=True)]
    for rows in sorted(groups, key=lambda rows: -rows["run_id"].nunique()):
        first = rows.iloc[0]
        words = [str(int(first[c])) if c == "steps" else "".join(condition_words(first, [c])) for c in told]
        yield "-".join(_plain(word) for word in words if word), rows


def _plain(text: str) -> str:
    return re.sub(r"[^0-9A-Za-z]+", "-", text.lower()).strip("-")
