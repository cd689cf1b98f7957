"""The command that prints the standing of the paper's claims beside results."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.text import Text

from analysis.baselines.catalogue import Sources, read
from analysis.claims.judging import Verdict, root_verdicts
from analysis.statistics.samples import Standing
from tma_ray.terminal import terminal

STYLES = {
    Standing.SUPPORTED: "green",
    Standing.REFUTED: "red",
    Standing.UNDECIDED: "yellow",
    Standing.NO_DATA: "dim",
}


def show_claims(sources: Sources, details: bool = False, console: Console | None = None) -> None:
    """Prints the paper's claims and their standing beside the results of a root.

    Args:
        sources: results roots and baselines.
        details: also every single statement, with the numbers behind it.
        console: where to print.

    Raises:
        ResultsRootError: no results root at that place.
    """
    console = terminal(console)
    frames = read(sources)
    verdicts, notes = root_verdicts(frames)
    for verdict in verdicts:
        if verdict.standing is Standing.NO_DATA and not details:
            continue
        style = STYLES[verdict.standing]
        console.print(Text.assemble((str(verdict.standing), style), f": {verdict.claim.text}"))
        console.print(f"  {verdict.claim.source}; {verdict.describe()}", highlight=False)
        for finding in verdict.findings if details else ():
            console.print(f"    {finding.standing}: {finding.evidence}", highlight=False, markup=False)
    missing = [verdict for verdict in verdicts if verdict.standing is Standing.NO_DATA]
    if missing and not details:
        console.print(_without_data(missing, len(verdicts)), highlight=False, markup=False, style="dim")
    for warning in (*frames.notes, *notes):
        console.print(warning, highlight=False, markup=False, style="dim")


def _without_data(missing: Sequence[Verdict], total: int) -> str:
    """Returns one sentence for all claims without data, with the command that lists them."""
    sources = dict.fromkeys(verdict.claim.source for verdict in missing)
    return (
        f"{Standing.NO_DATA}: {len(missing)} of {total} claims ({', '.join(sources)}); "
        f"the same command with --details lists what they need"
    )
