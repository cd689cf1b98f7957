"""The command that prints results of simulated students: mastered tasks, recovery after resets."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
from rich.table import Table
from scipy import stats

from analysis.formatting import number, plus_minus
from analysis.statistics import CONFIDENCE, describe, welch
from tma_ray.tasks import KnowledgeLevel
from tma_ray.terminal import terminal

BASELINE = "random"

BETTER, WORSE = "\N{BLACK UP-POINTING TRIANGLE}", "\N{BLACK DOWN-POINTING TRIANGLE}"
"""Marks of a difference from Random with p < 0.05 by Welch's test."""

RECOVERY = {"before_reset": "before", "tenth_later": "10 % later", "three_tenths_later": "30 % later"}


def check_file(path: Path) -> None:
    """Refuses a file that `write` could not write.

    Raises:
        ValueError: another ending than .csv and .parquet, or no such folder.
    """
    if path.suffix not in (".csv", ".parquet"):
        raise ValueError(f"{path}: expected a file that ends in .csv or .parquet")
    if not path.absolute().parent.is_dir():
        raise ValueError(f"{path}: the folder {path.absolute().parent} does not exist")


def write(frame: pd.DataFrame, path: Path) -> None:
    """Writes `frame` as CSV or Parquet, whichever `path` ends in."""
    if path.suffix == ".csv":
        frame.to_csv(path, index=False, float_format="%.10g")
    else:
        frame.to_parquet(path, index=False)


def show(frame: pd.DataFrame) -> None:
    """Prints both tables to the terminal."""
    console = terminal()
    title = "mastered test tasks in %, mean ± 95 % margin over seeds"
    console.print(rich_table(mastered_table(frame), f"{title}; {BETTER}{WORSE} differs from {BASELINE}"))
    recovery = recovery_table(frame)
    if len(recovery):
        console.print(rich_table(recovery, f"around the first reset of the student: {title}"))


def margin(values: pd.Series) -> float:
    """Returns half the width of the 95 % confidence interval of the mean; NaN for a single value."""
    described = describe(values)
    if described.n < 2:
        return math.nan
    return float(stats.t.ppf((1 + CONFIDENCE) / 2, described.n - 1)) * described.standard_error


def mastered_table(frame: pd.DataFrame) -> pd.DataFrame:
    """Returns mastered per cent as text, mean ± 95 % margin over seeds: teachers x challenges.

    Args:
        frame: rows of `tma_ray.testing.matrix.tabulate`.

    Returns:
        Columns teacher, expert knowledge, and one per challenge. Levels that make no difference to a
        teacher are one row; a level that it cannot run with is a row of dashes.
    """
    challenges = list(dict.fromkeys(frame["challenge"]))
    rows = []
    for teacher, levels, runs in _rows(frame):
        row = {"teacher": teacher, "expert knowledge": levels}
        for challenge in challenges:
            cell = runs[runs["challenge"] == challenge]
            row[challenge] = _entry(cell, frame[frame["challenge"] == challenge])
        rows.append(row)
    return pd.DataFrame(rows)


def recovery_table(frame: pd.DataFrame) -> pd.DataFrame:
    """Returns mastered per cent around the first reset of forgetting students, as `mastered_table` does."""
    forgetting = frame[frame["before_reset"].notna()]
    rows = [
        {"teacher": teacher, "expert knowledge": levels}
        | {title: _mean(runs[name]) for name, title in RECOVERY.items()}
        for teacher, levels, runs in _rows(forgetting)
    ]
    return pd.DataFrame(rows)


def markdown(table: pd.DataFrame) -> str:
    """Returns a table of texts as Markdown."""
    lines = [list(table.columns), ["---"] * len(table.columns), *table.to_numpy().tolist()]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def rich_table(table: pd.DataFrame, title: str) -> Table:
    """Returns a table of texts for a terminal."""
    grid = Table(title=title, title_justify="left", box=None)
    for index, column in enumerate(table.columns):
        grid.add_column(column.replace("_", " "), justify="left" if index < 2 else "right")
    for row in table.to_numpy().tolist():
        grid.add_row(*row)
    return grid


def _rows(frame: pd.DataFrame) -> Iterator[tuple[str, str, pd.DataFrame]]:
    """Yields teacher, levels that share their runs or are refused alike, and the rows of the first."""
    for teacher in dict.fromkeys(frame["teacher"]):
        own = frame[frame["teacher"] == teacher]
        used = own.drop_duplicates("expert_knowledge").set_index("expert_knowledge")["effective_knowledge"]
        levels = used.fillna("").loc[[level.value for level in KnowledgeLevel if level.value in used.index]]
        for effective, sharing in levels.groupby(levels, sort=False):
            runs = own[own["expert_knowledge"] == sharing.index[0]]
            yield teacher, (" = " if effective else ", ").join(sharing.index), runs


def _mean(values: pd.Series) -> str:
    return plus_minus(describe(values).mean, margin(values))


def _entry(cell: pd.DataFrame, challenge: pd.DataFrame) -> str:
    values = cell["mastered_percent"].dropna()
    if values.empty:
        return number(math.nan)
    text = _mean(values)
    baseline = challenge[challenge["teacher"] == BASELINE].drop_duplicates("seed")
    if baseline.empty or cell["teacher"].iloc[0] == BASELINE:
        return text
    comparison = welch(values, baseline["mastered_percent"])
    mark = BETTER if comparison.difference > 0 else WORSE
    return f"{text} {mark}" if comparison.significant else text
