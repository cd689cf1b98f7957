"""The figures of one comparison, with captions that say what is shown and of how many seeds."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from analysis.comparison import Measured
from analysis.curriculum_pictures import curriculum_pictures
from analysis.figures import final_bars, learning_curve, mastery_map
from analysis.formatting import number
from analysis.frames import Frames
from analysis.measures import RECENT, mastered_tasks
from analysis.picture import Picture
from analysis.style import label, teacher_order
from analysis.task_axes import task_axes

CURVES = (
    ("mastered_percent", "Mastered test tasks (%)", "Mastered test tasks over training"),
    ("evaluation_return", "Mean return on the test set", "Return on the test set"),
    ("training_return", "Mean return of training episodes", "Return in training"),
)
"""Column, label of the axis and title of each learning curve."""


def pictures(frames: Frames, mine: Measured) -> Iterator[Picture]:
    """Yields what there is to draw of one comparison."""
    for value, ylabel, title in CURVES:
        table = mine.training if value == "training_return" else mine.evaluations
        if len(table):
            figure = learning_curve(table, value, ylabel)
            yield Picture.of(value.replace("_", "-"), figure, title, _curve_caption(value, table))
    if mine.readings.empty:
        return
    caption = (
        f"Bars are means, whiskers ± one standard deviation, dots single seeds; {counts(mine.readings)}."
    )
    yield Picture.of(
        "final-mastered", final_bars(mine.readings), "Mastered test tasks, seed by seed", caption
    )
    yield from _mastery(frames, mine)
    yield from curriculum_pictures(frames, mine)


def _curve_caption(value: str, table: pd.DataFrame) -> str:
    text = f"Lines are means over seeds, bands ± one standard error of the mean; {counts(table)}."
    if (table["status"] == "running").any():
        text += " A line is thin where some of its runs have yet to arrive."
    if value == "training_return":
        if table["smoothed"].any():
            text += f" A run counts with the mean of its latest {RECENT} episodes."
        text += " Each teacher chooses its own training tasks: a low return may mean hard tasks."
    return text


def _mastery(frames: Frames, mine: Measured) -> Iterator[Picture]:
    shares, axes = mastered_tasks(frames, mine.readings), task_axes(mine.cells)
    plane = (axes[0], axes[1]) if len(axes) == 2 else None
    for test_set, rows in shares.groupby("test_set"):
        tasks = frames.test_tasks[frames.test_tasks["test_set"] == test_set]
        caption = (
            f"Share of seeds whose last return on the task is over {thresholds(mine.cells)}, for the "
            f"{len(tasks)} tasks of test set {test_set}; beside each name the mean over tasks; "
            f"{counts(mine.readings)}."
        )
        figure = mastery_map(rows, tasks, plane)
        yield Picture.of(f"mastery-{test_set}", figure, "Which test tasks are mastered", caption)


def counts(rows: pd.DataFrame) -> str:
    """Returns how many runs stand behind each teacher: ``n = 4 seeds``, or one number per teacher."""
    counts = rows.groupby("teacher")["run_id"].nunique()
    usual = int(counts.mode().iloc[-1])
    text = f"n = {usual} seed{'s' if usual > 1 else ''}" + (" per teacher" if len(counts) > 1 else "")
    others = [name for name in sorted(counts.index, key=teacher_order) if counts[name] != usual]
    return ", but ".join(
        [text, *([" and ".join(f"{counts[name]} of {label(name)}" for name in others)] if others else [])]
    )


def thresholds(cells: pd.DataFrame) -> str:
    """Returns the episodic return over which tasks are mastered, or all of them: ``230``."""
    found = sorted(cells["mastery_threshold"].dropna().unique())
    return " or ".join(number(value, 0 if value == round(value) else 2) for value in found)
