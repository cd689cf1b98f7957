"""The command that prints the best point of a search beside the paper's choice."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd
from rich.console import Console
from rich.table import Table

from analysis.baselines.catalogue import Sources, read
from analysis.formatting import p_value, plus_minus
from analysis.measures.evaluations import final_evaluations, search_results
from analysis.names import label
from analysis.statistics import welch
from tma_ray.terminal import terminal


def show_search(sources: Sources, console: Console | None = None) -> None:
    """Prints the best point of each grid beside the paper's choice, from what is there.

    Args:
        sources: results roots.
        console: where to print.

    Raises:
        ResultsRootError: no results root at that place.
    """
    frames, console = read(sources), terminal(console)
    found = search_results(frames)
    if found.empty:
        console.print("No point of a search has been run to its end here.")
        return
    table = Table("searched", "points", "best by mean", "mastered %", box=None, pad_edge=False)
    for heading in ("the paper's choice", "mastered %", "Welch"):
        table.add_column(heading)
    finals = final_evaluations(frames)
    for name, points in found.groupby("searched", sort=True):
        table.add_row(label(str(name)), str(len(points)), *_beside(points, finals))
    console.print(table)


def _beside(points: pd.DataFrame, finals: pd.DataFrame) -> list[str]:
    """Returns the best of `points` and the paper's choice, each with its result, and a test between them."""
    best, chosen = points.iloc[0], points[points["chosen"]]
    cells = [_text(best["point"]), plus_minus(best["mean"], best["std"])]
    if chosen.empty:
        return [*cells, "not run yet", "", ""]
    theirs = chosen.iloc[0]
    samples = (
        finals[finals["experiment"] == row["experiment"]].set_index("run_id")["mastered_percent"]
        for row in (best, theirs)
    )
    test = welch(*samples)
    cells += [_text(theirs["point"]), plus_minus(theirs["mean"], theirs["std"])]
    return [*cells, test.reason or p_value(test.p)]


def _text(point: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {value:g}" for name, value in point.items())
