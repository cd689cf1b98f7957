"""Leaderboards in the terminal and as Markdown.

`names` are names of releases, folders or addresses of results; all known releases by default, the newest
first. An unknown or damaged release raises `BaselineError`, and an address without results
`ResultsRootError`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from analysis.baselines import BaselineError, BaselineKind, as_baseline, baselines
from analysis.baselines.catalogue import Baseline, read
from analysis.charts.base import Chart
from analysis.charts.intervals import DIFFERENCES, ORDERS, budget_chart, difference_chart
from analysis.comparisons.against_random import FAMILY
from analysis.comparisons.budgets import compare_budgets
from analysis.comparisons.leaderboards import Entry, Leaderboard, leaderboards, notes
from analysis.data.frames import object_strings
from analysis.data.reference import is_baseline
from analysis.formatting import estimate, interval_text, number
from analysis.measures.evaluations import ceiling_sentences
from analysis.measures.run_measures import NEARLY_ALL
from analysis.measures.tested import AXES, FINAL, HEADLINE, MEASURES
from analysis.names import label, short_title
from analysis.tables.table import pipe_table
from tma_ray.console.terminal import print_text, terminal

if TYPE_CHECKING:
    from analysis.trials.design import Design
    from analysis.trials.interim import InterimLook

EXPLANATION = (
    "Mastered test tasks, %: mean over seeds and the challenges of a table, of equal weight, on two axes: "
    f"{AXES[HEADLINE]}, the mean over training, and {AXES[FINAL]}, the mean of the last three evaluations.",
    "Beside Random: difference in points, with intervals that hold for all tests of a family at once with "
    f"probability 0.95. Families: {FAMILY}. An interval without 0 is a verdict.",
    "Rank: by the mean among the teachers of the core, tested in all pairs; in brackets the ranks that tests "
    "leave open, then the probability that the true mean is the highest of all. A teacher marked * joined "
    "later: it is ranked with the core by its own tests, and leaves the core's ranks as they are.",
    "Tests are Welch's over challenges and bodies, in which each variance counts with at least half of the "
    "mean of the core's teachers, and paired by seed where seeds share a simulated student; p is corrected "
    "by Holm. A teacher without results on all challenges is ranked on those that it has, in another table.",
    f"Marked †: the student learns from under {NEARLY_ALL:g} % of the steps, since other episodes only score "
    "or try tasks; its mean over training is compared for the same number of trained steps, too.",
)
"""Definitions, one per paragraph."""

NO_BREAK = "\N{NO-BREAK SPACE}"

COLUMN_AXES = (FINAL, HEADLINE)  # measures in the order of the columns

TEACHER_WIDTH = 18
"""Width of the teacher column in the terminal, in characters; a whole board then fits into 100."""

CHALLENGE_WIDTH = 11  # width of a challenge's column, in characters, so that six fit on a line


@object_strings()
def show_leaderboards(
    names: Sequence[str] = (),
    console: Console | None = None,
    *,
    explain: bool = False,
    challenges: bool = False,
    subsets: bool = False,
    trials: bool = False,
) -> None:
    """Print the leaderboards of releases.

    Args:
        names: releases or results.
        console: console to print on; the terminal by default.
        explain: True to add the tasks that no run masters, and definitions.
        challenges: True to add the results on each challenge.
        subsets: True to add the tables of teachers on some of the challenges.
        trials: True to add the verdicts of trials by which teachers joined, which take seconds.
    """
    console = terminal(console)
    for name, location, gaps in release_locations(names):
        boards = leaderboards(frames := read(location), subsets=subsets)
        if not boards:
            print_text(console, f"{name}: no run has been evaluated here.")
        for board in boards:
            print_text(console, f"{name}: {board.title}", "bold")
            show_board(board, console)
            if budgets := compare_budgets(frames, board.runs):
                print_text(console, budgets.sentence(), "dim")
            if challenges:
                for axis in COLUMN_AXES:
                    print_text(console, f"{_on_each(board)}, {MEASURES[axis]}:")
                    console.print(_challenges(board, axis))
            print_text(console, "")
        for line in _trial_lines(location) if trials else ():
            print_text(console, line)
        ceilings = ceiling_sentences(frames) if explain else ()
        for sentence in [*([f"{name} is partial: {gaps}"] if gaps else []), *ceilings]:
            print_text(console, sentence, "dim")
    for paragraph in EXPLANATION if explain else ():
        print_text(console, paragraph, "dim")


def show_board(board: Leaderboard, console: Console) -> None:
    """Print a leaderboard: sentences about the best teachers, a table, and notes."""
    if answer := board.answer():
        print_text(console, answer)
    console.print(_table(board))
    for note in notes(board):
        print_text(console, note, "dim")


def release_locations(names: Sequence[str]) -> list[tuple[str, str, str]]:
    """Return the name, location and missing runs of each named release, or of all releases, newest first."""
    if not names:
        releases = [release for release in baselines() if release.manifest.kind is BaselineKind.RUNS]
        return list(map(_described, sorted(releases, key=lambda release: release.manifest.created)[::-1]))
    named = ((name, as_baseline(name)) for name in names)
    return [_described(release) if release else (name, name, "") for name, release in named]


def _described(baseline: Baseline) -> tuple[str, str, str]:
    if baseline.manifest.kind is not BaselineKind.RUNS:
        raise BaselineError(f"{baseline.manifest.name} has no runs, only published results: no leaderboard")
    return baseline.manifest.name, baseline.location, baseline.manifest.partial


def difference_charts(name: str) -> Iterator[tuple[str, Chart]]:
    """Yield the file name and the chart of each picture to which `markdown` refers."""
    for position, board in enumerate(leaderboards(frames := read(name)), start=1):
        if any(entry.against for entry in board.entries):
            compared = [entry.against for entry in board.entries if entry.against]
            yield _picture(name, position), difference_chart(compared, board.names, board.title)
        if budgets := compare_budgets(frames, board.runs):
            yield _picture(name, position, "-budgets"), budget_chart(budgets, board.names, board.title)


def _picture(release: str, position: int, suffix: str = "") -> str:
    return f"{Path(release).name}-{position}{suffix}.svg"


@object_strings()
def markdown(name: str, pictures: str = ".") -> str:
    """Return the leaderboards of a release as Markdown.

    Args:
        name: name, folder or address of the release.
        pictures: folder of the charts from `difference_charts`, relative to the folder of the page.
    """
    ((_, location, gaps),) = release_locations([name])
    parts = [f"*This release is not complete: {gaps}.*"] if gaps else []
    for position, board in enumerate(leaderboards(frames := read(location)), start=1):
        parts.append(f"## {board.title[0].upper()}{board.title[1:]}")
        parts += [text] if (text := board.answer()) else []
        if any(entry.against for entry in board.entries):
            parts.append(f"![Differences to Random, {board.title}]({pictures}/{_picture(name, position)})")
            parts.append(f"*{DIFFERENCES}*")
        parts.append(pipe_table(HEADS, (_row(board, entry) for entry in board.entries), range(1, 7)))
        parts += notes(board)
        parts += trials_markdown(location) if position == 1 else ()
        if budgets := compare_budgets(frames, board.runs):
            parts.append(budgets.sentence())
            parts.append(
                f"![Ranks by budget, {board.title}]({pictures}/{_picture(name, position, '-budgets')})"
            )
            parts.append(f"*{ORDERS}*")
            rows = [budgets.row(budget) for budget in budgets.budgets[1:]]
            parts.append(pipe_table(BUDGET_HEADS, rows, range(1, len(BUDGET_HEADS))))
        head = ["teacher", *map(short_title, board.columns)]
        for axis in COLUMN_AXES:
            results = [[board.marked(entry), *_results(board, entry, axis)] for entry in board.entries]
            table = pipe_table(head, results, range(1, len(head)))
            parts.append(folded(f"{_on_each(board)}, {MEASURES[axis]}", table))
    parts.append(folded("Ceilings", "\n\n".join(ceiling_sentences(frames))))
    return "\n\n".join(parts) if len(parts) > 1 else "No run has been evaluated here."


def _joined(location: str) -> list[tuple[Design, InterimLook]]:
    """Return the designs and last looks of the trials through which teachers joined a release."""
    from analysis.trials.interim import joined_trials  # deferred: slow to import

    baseline = as_baseline(location)
    return joined_trials(baseline) if baseline else []


def _trial_lines(location: str) -> Iterator[str]:
    """Yield the verdicts of the trials through which teachers joined a release, one line per trial."""
    from analysis.trials.interim import look_line  # deferred: slow to import

    for design, look in _joined(location):
        yield f"{label(design.teacher)}, {look_line(look)}"


def trials_markdown(location: str) -> Iterator[str]:
    """Yield Markdown paragraphs about the trials through which teachers joined a release."""
    rows, head = [], list[str]()
    for design, look in _joined(location):
        head = ["teacher", "seeds"]
        row = [label(design.teacher), str(look.seeds)]
        for result in look.settled:
            best = "" if is_baseline(result.reference) else ", the best of the core"
            head.append(f"{AXES[result.measure]}, against {label(result.reference)}{best}")
            row.append(f"{number(result.value)} {interval_text(result.low, result.high)}, {result.verdict}")
        rows.append(row)
    if rows:
        yield "Verdicts of the [trials](trials.md) by which teachers joined, against two references:"
        yield pipe_table(head, rows)


def folded(summary: str, text: str) -> str:
    """Return a collapsible section in Markdown, with `summary` as its title."""
    return f'<details markdown="1"><summary>{summary}</summary>\n\n{text}\n\n</details>'


def _cells(entry: Entry, axis: str) -> list[str]:
    """Return the formatted mean, difference from Random and rank of a teacher by a measure."""
    rank, against = entry.ranks[axis], entry.against
    open_ranks = f" [{rank.best} to {rank.worst}]" if rank.best < rank.worst else ""
    return [number(rank.mean), str(against.gaps[axis]) if against else "", f"{rank.rank}{open_ranks}"]


HEADS = [
    "teacher",
    *(head for axis in COLUMN_AXES for head in (f"{MEASURES[axis]}, %", "beside Random", "rank")),
    *("beside Random, both axes", "runs"),
]


BUDGET_HEADS = [
    "steps",
    *(head for axis in COLUMN_AXES for head in (f"agreement with the order {AXES[axis]}", "reversed pairs")),
]


LEAST_CHANCE = 0.005
"""Smallest probability of being the best that is shown."""


def _row(board: Leaderboard, entry: Entry) -> list[str]:
    numbers: list[str] = []
    for axis in COLUMN_AXES:
        chance = entry.ranks[axis].chance
        mean, gap, rank = _cells(entry, axis)
        numbers += [mean, gap, f"{rank}, {number(100 * chance, 0)} %" if chance >= LEAST_CHANCE else rank]
    verdict = entry.against.verdict if entry.against else ""
    runs = str(entry.ranks[HEADLINE].n)
    marked = board.marked(entry).replace("*", "\\*")
    return [marked, *(text.replace(" ", NO_BREAK) for text in numbers), verdict, runs]


def _table(board: Leaderboard) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("teacher", width=TEACHER_WIDTH, overflow="fold")
    for axis in COLUMN_AXES:
        for heading in (AXES[axis], "beside Random", "rank"):
            table.add_column(heading, justify="right")
    for entry in board.entries:
        cells = (text.replace(" to ", "\N{EN DASH}") for axis in COLUMN_AXES for text in _cells(entry, axis))
        table.add_row(board.marked(entry), *cells)
    return table


def _on_each(board: Leaderboard) -> str:
    return "On each body" if board.bodies else "On each challenge"


def _challenges(board: Leaderboard, axis: str) -> Table:
    """Return a table of results by challenge or body, rounded so that six columns fit on a line."""
    table = Table(box=None, pad_edge=False, padding=(0, 0, 0, 1))
    table.add_column("teacher", width=TEACHER_WIDTH, overflow="fold")
    for title in board.columns:
        table.add_column(short_title(title), justify="right", max_width=CHALLENGE_WIDTH, overflow="fold")
    for entry in board.entries:
        results = (text.replace(", ", ",") for text in _results(board, entry, axis))
        table.add_row(board.marked(entry), *results)
    return table


def _results(board: Leaderboard, entry: Entry, axis: str) -> list[str]:
    results = (entry.results[axis].get(title) for title in board.columns)
    return [estimate(*result, 0) if result else "" for result in results]
