"""The command that prints the smallest differences that a plan can detect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

from analysis.comparisons.planning import LITE, PAPER, detectable_differences
from analysis.formatting import number
from analysis.statistics import SIGNIFICANCE
from analysis.statistics.power import POWER
from tma_ray.terminal import terminal


def show_detectable_differences(
    cell_rows: Sequence[Mapping[str, Any]], steps: int, console: Console | None = None
) -> None:
    """Prints `detectable_differences`."""
    table = Table("challenge", box=None, pad_edge=False, header_style="bold")
    for heading in ("seeds", "steadiest", "typical", "most varied", "as in"):
        table.add_column(heading, justify="right")
    for _, row in detectable_differences(cell_rows, steps).iterrows():
        marks = (number(row[name]) for name in ("steadiest", "typical", "most_varied"))
        table.add_row(f"{row['environment']} {row['challenge']}", str(row["seeds"]), *marks, row["spread_of"])
    console = terminal(console)
    console.print(
        f"\nSmallest difference between two teachers, in points of mastered tasks, that Welch's test finds "
        f"with {POWER:.0%} power at p < {SIGNIFICANCE}, for teachers whose seeds scatter as in the results "
        f"of the last column: {PAPER} (SAC, 20 million steps), {LITE} (PPO, 2 million steps):",
        highlight=False,
    )
    console.print(table)
