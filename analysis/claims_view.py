"""The paper's claims beside a root's results, for a page and for a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from analysis.claim_sources import RootSource
from analysis.claims import Verdict, judge
from analysis.frames import Frames, load
from analysis.statistics.verdicts import Standing

STYLES = {
    Standing.SUPPORTED: "green",
    Standing.REFUTED: "red",
    Standing.UNDECIDED: "yellow",
    Standing.NO_DATA: "dim",
}


def decided(verdicts: Sequence[Verdict]) -> list[Verdict]:
    """Returns those of `verdicts` of which the results say anything, if only about one statement."""
    return [
        verdict
        for verdict in verdicts
        if any(finding.standing is not Standing.NO_DATA for finding in verdict.findings)
    ]


def root_verdicts(frames: Frames) -> list[Verdict]:
    """Returns what the results of a root say of each of the paper's claims."""
    return judge(RootSource(frames))


def show_claims(root: str | Path, details: bool = False, console: Console | None = None) -> None:
    """Prints the paper's claims and their standing beside the results of a root.

    Args:
        root: results root.
        details: also every single statement, with the numbers behind it.
        console: where to print.

    Raises:
        ResultsRootError: there is no such root.
    """
    console = console or Console()
    frames = load(root)
    for verdict in root_verdicts(frames):
        style = STYLES[verdict.standing]
        console.print(f"[{style}]{verdict.standing}[/{style}]: {verdict.claim.text}", highlight=False)
        console.print(f"  {verdict.claim.source}; {verdict.describe()}", highlight=False)
        for finding in verdict.findings if details else ():
            console.print(f"    {finding.standing}: {finding.evidence}", highlight=False, markup=False)
    for warning in frames.warnings:
        console.print(warning, highlight=False, markup=False, style="dim")
