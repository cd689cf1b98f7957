"""Verdicts on the paper's claims in the terminal."""

from collections import Counter
from collections.abc import Iterator
from functools import partial

from rich.console import Console
from rich.table import Table
from rich.text import Text

from analysis.baselines.catalogue import Sources, read
from analysis.claims.judging import ClaimVerdict, decided, root_verdicts
from analysis.data.frames import object_strings
from analysis.statistics.samples import DEFAULT_MARGIN, Standing
from tma_ray.console.terminal import print_text, terminal
from tma_ray.support.texts import counted

MAX_WIDTH = 100  # maximum number of characters in a line

STYLES = {
    Standing.SUPPORTED: "green",
    Standing.REFUTED: "red",
    Standing.NOT_SEEN: "red",
    Standing.UNDECIDED: "yellow",
    Standing.NO_DATA: "dim",
}

EXPLAINED = (
    "Claims are about the paper's measure: test tasks mastered at the last evaluation.",
    f"A statement is supported where a 95 % interval excludes its contrary, with a margin of "
    f"{DEFAULT_MARGIN:g} points of mastered tasks, and refuted where it excludes the statement; "
    f"otherwise it is undecided.",
    "With other students or budgets than the paper's, a statement is not refuted but not seen here.",
    "A claim holds if enough of its statements do: all of them, or the number that the claim gives.",
    "Tests compare teachers within each body and student, with equal weights.",
    "Statements about the same runs, as at levels of knowledge that a teacher does not use, count once.",
)
"""Definitions of the words in the table."""


@object_strings()
def show_claims(
    sources: Sources, details: bool = False, explain: bool = False, console: Console | None = None
) -> None:
    """Print the paper's claims and whether results support or refute them.

    Args:
        sources: results roots and baselines.
        details: True to add every statement with its numbers.
        explain: True to add definitions.
        console: console to print on; the terminal by default.

    Raises:
        ResultsRootError: if one of `sources` is not a results root.
    """
    console, frames = terminal(console), read(sources)
    verdicts, notes = root_verdicts(frames)
    width = min(console.width, MAX_WIDTH)
    show = partial(print_text, console, width=width)
    shown = decided(verdicts)
    if shown:
        console.print(_table(shown), width=width)
    for note in (*_notes(verdicts), *frames.notes, *notes):
        show(note, "dim")
    if not details:
        show("--details prints every statement with its numbers.", "dim")
    if not explain:
        show("--explain prints what the words mean.", "dim")
    for verdict in verdicts if details else ():
        show(
            Text.assemble("\n", (verdict.standing_text, STYLES[verdict.standing]), f": {verdict.claim.text}")
        )
        show(f"  {verdict.claim.source}; {verdict.describe()}")
        for finding in verdict.findings:
            show(f"    {finding.standing}: {finding.evidence}")
    for text in EXPLAINED if explain else ():
        show(text)


def _notes(verdicts: list[ClaimVerdict]) -> Iterator[str]:
    """Yield notes on claims without data, and on the conditions of claims "not seen here"."""
    missing = [verdict for verdict in verdicts if verdict.standing is Standing.NO_DATA]
    if missing:
        papers = ", ".join(dict.fromkeys(verdict.claim.source for verdict in missing))
        yield f"{Standing.NO_DATA}: {len(missing)} of {counted(len(verdicts), 'claim')} ({papers})"
    for conditions in dict.fromkeys(v.conditions for v in verdicts if v.standing is Standing.NOT_SEEN):
        yield f"{Standing.NOT_SEEN}: under {conditions}, not the paper's conditions"


def _table(verdicts: list[ClaimVerdict]) -> Table:
    """Return a table with a row per claim: standing, text, numbers of supported and required statements."""
    table = Table("standing", "claim of the paper", box=None, pad_edge=False, header_style="bold")
    for heading in ("holds", "needs", "of"):
        table.add_column(heading, justify="right", no_wrap=True)
    for verdict in verdicts:
        counts = Counter(finding.standing for finding in verdict.findings)
        numbers = counts[Standing.SUPPORTED], verdict.needed, len(verdict.findings)
        standing = Text(str(verdict.standing), STYLES[verdict.standing], no_wrap=True)
        table.add_row(standing, verdict.claim.text, *map(str, numbers))
    return table
