"""The command that prints the ranking of teachers on each challenge."""

from __future__ import annotations

import re
import textwrap

import pandas as pd
from rich.console import Console
from rich.table import Table

from analysis.baselines.sources import Sources, read
from analysis.comparisons.overall import headlines
from analysis.comparisons.ranking import MEASURE, places, ranked, sentences
from analysis.data.reference import NO_BASELINE, is_baseline
from analysis.formatting import number, p_value, plus_minus
from analysis.measures.student_pools import runs_after
from analysis.names import label
from tma_ray.terminal import terminal

WIDTHS = {
    "teacher": 16,
    "mastered %": 12,
    "runs": 4,
    "beside Random, 95 %": 23,
    "Welch p": 7,
    "Holm p": 7,
}
"""Columns that are shown, and their widths in characters."""


def show_ranking(sources: Sources, share: float = 1.0, console: Console | None = None) -> None:
    """Prints who masters how much on each challenge of a root, and what that says.

    Raises:
        ResultsRootError: no results root at that place.
    """
    console, frames = terminal(console), read(sources)
    runs = runs_after(frames, share, training=False)
    table = ranked(runs)
    if table[f"{MEASURE}_mean"].notna().sum() == 0:
        console.print("No run has been evaluated to its end here.")
        return
    for (place, level), rows in table.groupby([pd.Series(places(table)), "expert_knowledge"], sort=False):
        console.print(f"{place}, expert knowledge {level}", style="bold", highlight=False, markup=False)
        console.print(_shown(rows))
        for reason, teachers in _untested(rows).items():
            console.print(
                f"  not tested: {', '.join(teachers)}: {reason}", style="dim", highlight=False, markup=False
            )
    for note in (*_notes(table), *frames.told, *frames.left_out):
        console.print(note, style="dim", highlight=False, markup=False)
    for sentence in [*headlines(runs), *sentences(table)]:
        console.print(sentence, highlight=False, markup=False)


def _shown(rows: pd.DataFrame) -> Table:
    """Returns the results of one challenge at one level, at most 80 columns wide."""
    shown = Table(box=None, pad_edge=False, padding=(0, 1))
    for heading, width in WIDTHS.items():
        shown.add_column(
            heading, width=width, justify="left" if heading == "teacher" else "right", no_wrap=True
        )
    for _, row in rows.iterrows():
        (name, *cells), style = _cells(row), "bold" if row["rank"] == 1 else None
        first, *settings = _lines(name)
        shown.add_row(first, *cells, style=style)
        for setting in settings:
            shown.add_row(setting, style=style)
    return shown


def _lines(name: str) -> list[str]:
    """Returns a teacher's name in lines as wide as its column, broken before settings where that can be."""
    lines: list[str] = []
    for place, part in enumerate(re.split(r"(?<=.)(?=:)", name)):
        indented = f"{'  ' if place else ''}{part}"
        lines += textwrap.wrap(indented, WIDTHS["teacher"], subsequent_indent="   ", drop_whitespace=False)
    return lines


def _cells(row: pd.Series) -> list[str]:
    result = plus_minus(row[f"{MEASURE}_mean"], row[f"{MEASURE}_std"])
    partly = "*" if row["missing"] else ""
    names = [label(row["teacher"]), result + partly, str(row["n"])]
    if is_baseline(row["teacher"]):
        return [*names, "", "", ""]
    if row["reason"] or pd.isna(row["p"]):
        return [*names, "not tested", "", ""]
    interval = f"{number(row['difference'])} [{number(row['low'])}, {number(row['high'])}]"
    return [*names, interval, *(p_value(row[name]).lstrip("p =\N{NO-BREAK SPACE}") for name in ("p", "holm"))]


def _untested(rows: pd.DataFrame) -> dict[str, list[str]]:
    """Returns why some teachers of a challenge are not tested against Random, and which."""
    found: dict[str, list[str]] = {}
    for _, row in rows.iterrows():
        if not is_baseline(row["teacher"]) and (row["reason"] or pd.isna(row["p"])):
            found.setdefault(row["reason"] or NO_BASELINE, []).append(label(row["teacher"]))
    return found


def _notes(table: pd.DataFrame) -> list[str]:
    """Returns what is missing of the results marked with an asterisk, each reason once."""
    gaps = table[table["missing"] != ""].groupby(["environment", "challenge"], sort=False)["missing"]
    return [f"* {challenge}: {'; '.join(dict.fromkeys(texts))}" for (_, challenge), texts in gaps]
