"""Captions of charts: counts of the runs behind them."""

from __future__ import annotations

import pandas as pd

from analysis.formatting import listed, number
from analysis.measures.training import RECENT
from analysis.names import label, teacher_order


def curve_caption(value: str, table: pd.DataFrame) -> str:
    """Returns the caption of learning curves of `value`, a column of `table`."""
    text = f"Lines are means over seeds, bands ± one standard error of the mean; {counts(table)}."
    if (table["status"] == "running").any():
        text += " Where some runs have yet to arrive, n is smaller."
    if value == "training_return":
        if table["smoothed"].any():
            text += f" A run counts with the mean of its latest {RECENT} episodes."
        text += " Each teacher chooses its own training tasks: a low return may mean hard tasks."
    return text


def counts(rows: pd.DataFrame) -> str:
    """Returns how many runs stand behind each teacher: ``n = 4 seeds``, or one number per teacher."""
    counts = rows.groupby("teacher")["run_id"].nunique()
    usual = int(counts.mode().iloc[-1])
    text = f"n = {usual} seed{'s' if usual > 1 else ''}" + (" per teacher" if len(counts) > 1 else "")
    others = [name for name in sorted(counts.index, key=teacher_order) if counts[name] != usual]
    return ", but ".join(
        [text, *([listed(f"{counts[name]} of {label(name)}" for name in others)] if others else [])]
    )


def thresholds(cells: pd.DataFrame) -> str:
    """Returns the episodic return over which tasks are mastered, or all of them: ``230``."""
    found = sorted(cells["mastery_threshold"].dropna().unique())
    return " or ".join(map(threshold, found))


def threshold(value: float) -> str:
    """Returns one such return, without decimals where it has none."""
    return number(value, 0 if value == round(value) else 2)
