"""The command that prints the ranking of teachers on each challenge."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping, Sequence

import pandas as pd
from rich.console import Console, JustifyMethod
from rich.table import Table

from analysis.baselines.catalogue import Sources, own_teachers, read
from analysis.comparisons.boards import BLOCK, THRESHOLDS, headlines, interval, overall, place_of
from analysis.comparisons.sentences import places, ranked, sentences
from analysis.data.reference import NO_BASELINE, is_baseline
from analysis.formatting import ends, number, p_value, plus_minus
from analysis.measures.pooling import runs_after, varying
from analysis.measures.tested import MEASURE, MEASURES, how_tested
from analysis.names import label, mark_of, own_first
from tma_ray.terminal import terminal

WIDTHS = {"teacher": 14, "": 12, "worst": 5, "runs": 4, "beside Random, 95 %": 23, "Holm p": 7}
"""Columns that are shown, and their widths in characters; the measure is named when it is known."""

OVERALL = {"teacher": 14, "runs": 4, "mean, %": 19, "beats Random": 17, "worst": 5}
"""Columns of the table over all challenges."""

FAMILIES = "all teachers against Random, on each challenge and over challenges apart"


def show_ranking(
    sources: Sources, share: float = 1.0, console: Console | None = None, measure: str = MEASURE
) -> None:
    """Prints who masters how much on each challenge of a root, and what that says.

    Args:
        sources: results roots and baselines.
        share: of the budget, after which runs are read.
        console: to print on; the terminal by default.
        measure: of `MEASURES`.

    Raises:
        ResultsRootError: no results root at that place.
    """
    console, frames = terminal(console), read(sources)
    runs = runs_after(frames, share, training=False)
    table = ranked(runs, measure)
    if table[f"{measure}_mean"].notna().sum() == 0:
        console.print("No run has been evaluated to its end here.")
        return
    with own_first(own_teachers(sources, frames)):
        for (place, level), rows in table.groupby([pd.Series(places(table)), "expert_knowledge"], sort=False):
            console.print(f"{place}, expert knowledge {level}", style="bold", highlight=False, markup=False)
            console.print(_shown(rows, measure))
            for reason, teachers in _untested(rows).items():
                text = f"  not tested: {', '.join(teachers)}: {reason}"
                console.print(text, style="dim", highlight=False, markup=False)
        for note in (*_notes(table), *frames.told, *frames.left_out):
            console.print(note, style="dim", highlight=False, markup=False)
        _show_overall(console, runs, measure)
    if table["p"].notna().any():
        console.print(how_tested(measure, FAMILIES), style="dim", highlight=False, markup=False)
    for sentence in [*headlines(runs, measure), *sentences(table)]:
        console.print(sentence, highlight=False, markup=False)


def _show_overall(console: Console, runs: pd.DataFrame, measure: str) -> None:
    """Prints estimates over the challenges that teachers share, level by level and budget by budget."""
    over = "/".join(map(str, THRESHOLDS))
    table = overall(runs, measure)
    told = ["steps", *(name for name in varying(table) if name != "steps")]
    for _, rows in table.groupby(BLOCK, dropna=False, sort=False):
        where = f"Over challenges: {place_of(rows.iloc[0], told)}"
        console.print(where, style="bold", highlight=False, markup=False)
        shown = _table({**OVERALL, f">{over} %": 11})
        for _, row in rows.iterrows():
            better = "" if is_baseline(row["teacher"]) else interval(row, "better", 2)
            shares = "/".join(number(100 * row[f"over_{threshold}"], 0) for threshold in THRESHOLDS)
            cells = [str(row["n"]), interval(row, "mean", 1), better, number(row["worst"]), shares]
            _add(shown, row["teacher"], cells)
        console.print(shown)


def _shown(rows: pd.DataFrame, measure: str) -> Table:
    """Returns the results of one challenge at one level, at most 80 columns wide."""
    shown = _table({name or MEASURES[measure]: width for name, width in WIDTHS.items()})
    for _, row in rows.iterrows():
        _add(shown, row["teacher"], _cells(row, measure), "bold" if row["rank"] == 1 else None)
    return shown


def _table(widths: Mapping[str, int]) -> Table:
    shown = Table(box=None, pad_edge=False, padding=(0, 1))
    for heading, width in widths.items():
        side: JustifyMethod = "left" if heading == "teacher" else "right"
        shown.add_column(heading, width=width, justify=side, no_wrap=True)
    return shown


def _add(table: Table, teacher: str, cells: Sequence[str], style: str | None = None) -> None:
    first, *settings = [*_lines(label(teacher)), *filter(None, [mark_of(teacher)])]
    table.add_row(first, *cells, style=style)
    for setting in settings:
        table.add_row(setting, style=style)


def _lines(name: str) -> list[str]:
    """Returns a teacher's name in lines as wide as its column, broken before settings where that can be."""
    lines: list[str] = []
    for place, part in enumerate(re.split(r"(?<=.)(?=:)", name)):
        indented = f"{'  ' if place else ''}{part}"
        lines += textwrap.wrap(indented, WIDTHS["teacher"], subsequent_indent="   ", drop_whitespace=False)
    return lines


def _cells(row: pd.Series, measure: str) -> list[str]:
    result = plus_minus(row[f"{measure}_mean"], row[f"{measure}_std"])
    partly = "*" if row["missing"] else ""
    numbers = [result + partly, number(row["worst"]), str(row["n"])]
    if is_baseline(row["teacher"]):
        return [*numbers, "", ""]
    if row["reason"] or pd.isna(row["p"]):
        return [*numbers, "not tested", ""]
    gap = f"{number(row['difference'])} {ends(row['low'], row['high'])}"
    return [*numbers, gap, p_value(row["holm"]).lstrip("p =\N{NO-BREAK SPACE}")]


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
