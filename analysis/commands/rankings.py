"""Results in the terminal: rankings, searches, detectable differences.

`sources` are results roots and baselines; one without results raises `ResultsRootError`. Output goes to
`console`, by default the terminal.
"""

import re
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd
from rich.console import Console, JustifyMethod
from rich.table import Table

from analysis.baselines.catalogue import Sources, own_teachers, read
from analysis.commands.leaderboards import EXPLANATION, show_board
from analysis.comparisons.against_random import Gap, against_random, sentences_against_random
from analysis.comparisons.leaderboards import leaderboards
from analysis.comparisons.planning import LITE, PAPER, detectable_differences
from analysis.comparisons.sentences import challenge_titles, ranked, ranking_sentences
from analysis.data.frames import object_strings
from analysis.data.reference import NO_BASELINE, is_baseline
from analysis.formatting import number, p_value, plus_minus
from analysis.measures.evaluations import final_evaluations, search_results
from analysis.measures.pooling import runs_after
from analysis.measures.tested import FINAL, HEADLINE, MEASURES, how_tested
from analysis.names import label, mark_of, own_first
from analysis.statistics import SIGNIFICANCE, welch
from analysis.statistics.power import POWER
from tma_ray.console.terminal import print_text, terminal

NAME_WIDTH = 14  # width of the teacher column, in characters

FAMILIES = "on each challenge the core against Random, and a newcomer alone"


@object_strings()
def show_ranking(
    sources: Sources,
    share: float = 1.0,
    console: Console | None = None,
    measure: str = HEADLINE,
    *,
    explain: bool = False,
) -> None:
    """Print the ranking of teachers over all challenges of a root, and on each challenge.

    Args:
        sources: results roots and baselines.
        share: share of the budget at which runs are measured.
        console: console to print on; the terminal by default.
        measure: name in `MEASURES`, by which teachers are ranked on each challenge.
        explain: True to add tables of teachers on some of the challenges, conclusions and definitions.

    Raises:
        ResultsRootError: if one of `sources` is not a results root.
    """
    console, frames = terminal(console), read(sources)
    runs = runs_after(frames, share, training=False)
    table = ranked(runs, measure)
    if table[f"{measure}_mean"].notna().sum() == 0:
        console.print("No run has been evaluated to its end here.")
        return
    with own_first(own_teachers(sources, frames)):
        for board in leaderboards(frames, runs, subsets=explain):
            if len(board.challenges) > 1:
                print_text(console, f"Over {len(board.challenges)} challenges: {board.title}", "bold")
                show_board(board, console)
        for (title, level), rows in table.groupby(
            [pd.Series(challenge_titles(table)), "expert_knowledge"], sort=False
        ):
            print_text(console, f"{title}, expert knowledge {level}", "bold")
            _show_challenge(console, rows, measure)
        gaps = table[table["missing"] != ""].groupby(["environment", "challenge"], sort=False)["missing"]
        notes = [f"* {challenge}: {'; '.join(dict.fromkeys(texts))}" for (_, challenge), texts in gaps]
        for note in (*notes, *frames.cell_warnings, *frames.skipped_files):
            print_text(console, note, "dim")
    if explain:
        for sentence in [*sentences_against_random(against_random(frames, runs)), *ranking_sentences(table)]:
            print_text(console, sentence)
        for paragraph in (*EXPLANATION, how_tested(FAMILIES)):
            print_text(console, paragraph, "dim")


def _show_challenge(console: Console, rows: pd.DataFrame, measure: str) -> None:
    """Print the results of one challenge at one level, at most 100 columns wide."""
    heads = [("teacher", NAME_WIDTH), (MEASURES[measure], 15), (MEASURES[FINAL], 10), ("runs", 4)]
    shown = _table([*heads, ("beside Random", 23), ("Holm p", 7)])
    untested: dict[str, list[str]] = {}
    for _, row in rows.iterrows():
        mastered = plus_minus(row[f"{measure}_mean"], row[f"{measure}_std"]) + "*" * bool(row["missing"])
        if is_baseline(row["teacher"]):
            tested = ["", ""]
        elif row["reason"] or pd.isna(row["p"]):
            tested = ["not tested", ""]
            untested.setdefault(row["reason"] or NO_BASELINE, []).append(label(row["teacher"]))
        else:
            gap = str(Gap.of(row))
            tested = [gap, p_value(row["holm"]).lstrip("p =\N{NO-BREAK SPACE}")]
        cells = [mastered, number(row[f"{FINAL}_mean"]), str(row["n"]), *tested]
        _add(shown, row["teacher"], cells, "bold" if row["rank"] == 1 else None)
    console.print(shown)
    for reason, teachers in untested.items():
        print_text(console, f"  not tested: {', '.join(teachers)}: {reason}", "dim")


def _table(heads: Sequence[tuple[str, int]]) -> Table:
    shown = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    for heading, width in heads:
        side: JustifyMethod = "left" if heading == "teacher" else "right"
        shown.add_column(heading, width=width, justify=side, no_wrap=True)
    return shown


def _add(table: Table, teacher: str, cells: Sequence[str], style: str | None = None) -> None:
    """Add a row; wrap the teacher's name to the column width, preferably before a `:name=value`."""
    lines: list[str] = []
    for index, part in enumerate(re.split(r"(?<=.)(?=:)", label(teacher))):
        indented = f"{'  ' if index else ''}{part}"
        lines += textwrap.wrap(indented, NAME_WIDTH, subsequent_indent="   ", drop_whitespace=False)
    first, *settings = [*lines, *filter(None, [mark_of(teacher)])]
    table.add_row(first, *cells, style=style)
    for setting in settings:
        table.add_row(setting, style=style)


def show_search(sources: Sources, console: Console | None = None) -> None:
    """Print the best finished point of each hyper-parameter search, and the paper's choice.

    Args:
        sources: results roots.
        console: console to print on; the terminal by default.

    Raises:
        ResultsRootError: if one of `sources` is not a results root.
    """
    frames, console = read(sources), terminal(console)
    results = search_results(frames)
    if results.empty:
        console.print("No point of a search has been run to its end here.")
        return
    table = Table("searched", "points", "best by mean", "mastered %", box=None, pad_edge=False)
    for heading in ("the paper's choice", "mastered %", "Welch"):
        table.add_column(heading)
    finals = final_evaluations(frames)
    for name, points in results.groupby("searched", sort=True):
        best, chosen = points.iloc[0], points[points["chosen"]]
        cells = [label(str(name)), str(len(points)), *_result(best)]
        if chosen.empty:
            table.add_row(*cells, "not run yet", "", "")
            continue
        samples = (
            finals[finals["experiment"] == row["experiment"]].set_index("run_id")["mastered_percent"]
            for row in (best, chosen.iloc[0])
        )
        test = welch(*samples)
        table.add_row(*cells, *_result(chosen.iloc[0]), test.reason or p_value(test.p))
    console.print(table)


def _result(row: pd.Series) -> tuple[str, str]:
    point = ", ".join(f"{name} {value:g}" for name, value in row["point"].items())
    return point, plus_minus(row["mean"], row["std"])


def show_detectable_differences(
    cell_rows: Sequence[Mapping[str, Any]], budgets: Mapping[str, int], console: Console | None = None
) -> None:
    """Print the smallest difference between two teachers that a plan can detect, by challenge."""
    table = Table("challenge", box=None, pad_edge=False, header_style="bold")
    for heading in ("seeds", "steadiest", "typical", "most varied", "as in"):
        table.add_column(heading, justify="right")
    for _, row in detectable_differences(cell_rows, budgets).iterrows():
        marks = (number(row[name]) for name in ("steadiest", "typical", "most_varied"))
        table.add_row(f"{row['environment']} {row['challenge']}", str(row["seeds"]), *marks, row["spread_of"])
    console = terminal(console)
    print_text(
        console,
        f"\nSmallest difference between two teachers, in points of mastered tasks, that Welch's test finds "
        f"with {POWER:.0%} power at p < {SIGNIFICANCE}, for teachers whose seeds scatter as in the results "
        f"of the last column: {PAPER} (SAC, 20 million steps, at the last evaluation), {' or '.join(LITE)} "
        f"(PPO, 2 million steps, over training):",
    )
    console.print(table)
