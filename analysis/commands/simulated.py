"""Tables of simulated students' results in the terminal: mastered tasks, recovery after resets."""

import math
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
from rich.table import Table

from analysis.data.reference import BASELINE, baseline_rows, is_baseline
from analysis.formatting import number, plus_minus
from analysis.statistics import SIGNIFICANCE, Comparison, describe, holm, mean_interval, paired
from analysis.tables.table import pipe_table
from tma_ray.console.terminal import terminal
from tma_ray.tasks import KnowledgeLevel

BETTER, WORSE = "\N{BLACK UP-POINTING TRIANGLE}", "\N{BLACK DOWN-POINTING TRIANGLE}"
"""Marks of a difference from Random with p < 0.05, corrected by Holm's method over each challenge."""

RECOVERY = {"before_reset": "before", "tenth_later": "10 % later", "three_tenths_later": "30 % later"}


def check_file(path: Path) -> None:
    """Check that `write` accepts a path.

    Raises:
        ValueError: if the suffix is neither .csv nor .parquet, or the folder does not exist.
    """
    if path.suffix not in (".csv", ".parquet"):
        raise ValueError(f"{path}: expected a file that ends in .csv or .parquet")
    if not path.absolute().parent.is_dir():
        raise ValueError(f"{path}: the folder {path.absolute().parent} does not exist")


def write(frame: pd.DataFrame, path: Path) -> None:
    """Write `frame` as CSV or Parquet, depending on the suffix of `path`."""
    if path.suffix == ".csv":
        frame.to_csv(path, index=False, float_format="%.10g")
    else:
        frame.to_parquet(path, index=False)


def show(frame: pd.DataFrame) -> None:
    """Print `mastered_table` of `frame`, and `recovery_table` if it has rows."""
    console = terminal()
    title = "mastered test tasks in %, mean ± 95 % margin over seeds"
    console.print(rich_table(mastered_table(frame), f"{title}; {BETTER}{WORSE} differs from {BASELINE}"))
    recovery = recovery_table(frame)
    if len(recovery):
        console.print(rich_table(recovery, f"around the first reset of the student: {title}"))


def mastered_table(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the mean percentage of mastered tasks ± its 95 % margin, as strings (teachers x challenges).

    Args:
        frame: rows from `tma_ray.testing.matrix.tabulate`.

    Returns:
        teacher, expert knowledge, and a column per challenge. Levels with the same runs are one row; an
        unsupported level is a row of dashes.
    """
    groups = list(_rows(frame))
    table = pd.DataFrame(
        [{"teacher": teacher, "expert knowledge": levels} for teacher, levels, _ in groups],
        columns=["teacher", "expert knowledge"],
    )
    for challenge, everything in frame.groupby("challenge", sort=False):
        baseline = baseline_rows(everything).drop_duplicates("seed")
        cells = [runs[runs["challenge"] == challenge] for *_, runs in groups]
        tests = [_against(cell, baseline) for cell in cells]
        texts = []
        for cell, test, p in zip(cells, tests, holm([test.p for test in tests]), strict=True):
            values = cell["mastered_percent"].dropna()
            mark = f" {BETTER if test.difference > 0 else WORSE}" if p < SIGNIFICANCE else ""
            texts.append(f"{_mean(values) if len(values) else number(math.nan)}{mark}")
        table[str(challenge)] = texts
    return table


def recovery_table(frame: pd.DataFrame) -> pd.DataFrame:
    """Return percentages of mastered tasks before and after the first reset, for students that are reset."""
    forgetting = frame[frame["before_reset"].notna()]
    rows = [
        {"teacher": teacher, "expert knowledge": levels}
        | {title: _mean(runs[name]) for name, title in RECOVERY.items()}
        for teacher, levels, runs in _rows(forgetting)
    ]
    return pd.DataFrame(rows)


def markdown(table: pd.DataFrame) -> str:
    """Convert a table of strings to Markdown."""
    return pipe_table(list(table.columns), table.to_numpy().tolist()) + "\n"


def rich_table(table: pd.DataFrame, title: str) -> Table:
    """Convert a table of strings to a rich table for the terminal."""
    grid = Table(title=title, title_justify="left", box=None)
    for index, column in enumerate(table.columns):
        grid.add_column(column.replace("_", " "), justify="left" if index < 2 else "right")
    for row in table.to_numpy().tolist():
        grid.add_row(*row)
    return grid


def _rows(frame: pd.DataFrame) -> Iterator[tuple[str, str, pd.DataFrame]]:
    """Yield one table row at a time: a teacher, the levels that share the same runs, and those runs."""
    for teacher in dict.fromkeys(frame["teacher"]):
        rows = frame[frame["teacher"] == teacher]
        used = rows.drop_duplicates("expert_knowledge").set_index("expert_knowledge")["effective_knowledge"]
        levels = used.fillna("").loc[[level.value for level in KnowledgeLevel if level.value in used.index]]
        for effective, sharing in levels.groupby(levels, sort=False):
            runs = rows[rows["expert_knowledge"] == sharing.index[0]]
            yield teacher, (" = " if effective else ", ").join(sharing.index), runs


def _mean(values: pd.Series) -> str:
    """Format the mean ± half the width of its 95 % interval, or a single value without an interval."""
    sample = describe(values)
    low, high = mean_interval(sample)
    return plus_minus(sample.mean, (high - low) / 2)


def _against(cell: pd.DataFrame, baseline: pd.DataFrame) -> Comparison:
    if cell.empty or is_baseline(str(cell["teacher"].iloc[0])):
        return Comparison(len(cell), len(baseline), math.nan, reason="the baseline, or no results")
    played = (rows[rows["mastered_percent"].notna()] for rows in (cell, baseline))
    # Paired, since runs with the same seed train identical students.
    return paired(*(rows.set_index("seed")["mastered_percent"] for rows in played))
