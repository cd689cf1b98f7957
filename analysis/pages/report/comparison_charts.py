"""The charts of one comparison: learning curves, seeds, mastered tasks, curricula."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import pandas as pd

from analysis.comparisons.examples import in_whose_space, which_runs
from analysis.comparisons.findings import MASTERED
from analysis.comparisons.measured import Measured
from analysis.data.curricula import Curriculum
from analysis.data.frames import Frames
from analysis.data.task_axes import task_axes
from analysis.measures.evaluations import aggregate, mastered_tasks
from analysis.pages.charts import (
    END,
    Chart,
    curve_chart,
    mastery_charts,
    probed_task_charts,
    seeds_chart,
    training_task_charts,
)
from analysis.pages.charts.curricula import EPISODES
from analysis.pages.charts.scalars import hidden_scalars, scalar_charts
from analysis.pages.report.captions import counts, curve_caption, thresholds

CURVES = (
    ("mastered_percent", "Mastered test tasks (%)", "Mastered test tasks over training"),
    ("evaluation_return", "Mean return on the test set", "Return on the test set"),
    ("training_return", "Mean return of training episodes", "Return in training"),
)
"""Column, label of the axis and title of each learning curve."""

QUANTITIES = {column: quantity for column, quantity, _ in CURVES}


MOST_ACROSS = 4
"""Charts of a panel side by side."""


@dataclass(frozen=True, eq=False)
class Panel:
    """Charts that stand together, one for each teacher, under one caption."""

    title: str
    caption: str
    charts: tuple[Chart, ...]

    @property
    def across(self) -> int:
        """Charts that the panel has side by side where there is room."""
        return min(len(self.charts), MOST_ACROSS)


def charts_of(mine: Measured, anchor: str) -> Iterator[Chart]:
    """Yields learning curves, and every seed at any step."""
    for value, quantity, title in CURVES:
        table = mine.training if value == "training_return" else mine.evaluations
        if len(table):
            curves = aggregate(table, value)
            name = f"{anchor}-{value.replace('_', '-')}"
            yield curve_chart(name, curves, quantity, title, curve_caption(value, table))
    if len(mine.finals):
        column = MASTERED.column
        caption = f"Rings are seeds, marks their means with 95 % intervals; {counts(mine.finals)}."
        points = points_of(mine, column)
        yield seeds_chart(f"{anchor}-seeds", points, QUANTITIES[column], "Seed by seed", caption)


def points_of(mine: Measured, column: str) -> pd.DataFrame:
    """Returns teacher, seed, step (or `END`) and value of every run, at every evaluation and at its end."""
    columns = ["teacher", "seed", "step", column]
    along = mine.evaluations[columns].astype({"step": object})
    ends = mine.finals[columns].assign(step=END)
    return pd.concat([along, ends], ignore_index=True).rename(columns={column: "value"})


def panels_of(
    frames: Frames, mine: Measured, curricula: Mapping[str, Curriculum], anchor: str
) -> Iterator[Panel]:
    """Yields which test tasks are mastered, and what teachers would teach, at any step."""
    if mine.finals.empty:
        return
    axes = task_axes(mine.cells)
    along = _shares(frames, mine)
    for test_set, shares in along.groupby("test_set"):
        tasks = frames.test_tasks[frames.test_tasks["test_set"] == test_set]
        caption = (
            f"Share of seeds whose return on the task is over {thresholds(mine.cells)}, from faint for none "
            f"to strong for all, of the {len(tasks)} tasks of test set {test_set}; beside each name the "
            f"mean over tasks; {counts(mine.finals)}."
        )
        charts = tuple(mastery_charts(f"{anchor}-mastery-{test_set}", shares, tasks, axes, caption))
        yield Panel("Which test tasks are mastered", caption, charts)
    yield from _curricula(mine, curricula, anchor)


def _curricula(mine: Measured, curricula: Mapping[str, Curriculum], anchor: str) -> Iterator[Panel]:
    axes, which = task_axes(mine.cells), which_runs(curricula)
    training_tasks = (
        f"{which}. Dots are training episodes of the latest fifth of it, at most {EPISODES}, coloured by "
        f"return, from dark violet for falling at once to yellow for mastered."
    )
    probed_tasks = (
        f"{which}. Dots are tasks probed without exploration; outlines are the teacher's latest Gaussians, "
        f"at two standard deviations, and its boxes.{in_whose_space(curricula)}"
    )
    for title, name, charts_for, caption in (
        ("Training tasks", "training-tasks", training_task_charts, training_tasks),
        ("Probed tasks", "probed-tasks", probed_task_charts, probed_tasks),
    ):
        charts = tuple(charts_for(f"{anchor}-{name}", curricula, axes, caption))
        if charts:
            yield Panel(title, caption, charts)
    logs = f"{which}: what teachers log at their updates; bands show the range where points are dense."
    hidden = hidden_scalars(curricula)
    logs += f" {hidden} more are in the table teacher_log." if hidden else ""
    charts = tuple(scalar_charts(f"{anchor}-teacher-log", curricula, logs))
    if charts:
        yield Panel("Teachers' logs", logs, charts)


def _shares(frames: Frames, mine: Measured) -> pd.DataFrame:
    """Returns teacher, step (or `END`), test_set, task_index, n and share of seeds that master the task."""
    runs = mine.evaluations[["run_id", "step", "teacher"]].drop_duplicates()
    rows = frames.evaluations_of(runs["run_id"].unique())
    rows = rows.astype({"run_id": object, "test_set": object}).merge(runs, on=["run_id", "step"])
    grouped = rows.groupby(["teacher", "step", "test_set", "task_index"], sort=True)["mastered"]
    along = grouped.agg(n="count", share="mean").reset_index().astype({"step": object})
    ends = mastered_tasks(frames, mine.finals).assign(step=END)
    return pd.concat([along, ends[along.columns]], ignore_index=True)
