"""The figures of one comparison, with captions that say what is shown and of how many seeds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from analysis.comparison import Measured
from analysis.curriculum import PANELS, POINTS, Curriculum, curriculum_strip, stack
from analysis.figures import Axis, final_bars, learning_curve, mastery_map
from analysis.load import Frames, parsed
from analysis.measures import RECENT, mastered_tasks
from analysis.style import label, png, teacher_order
from tma_ray.tasks import MASTERY_RETURN

CURVES = (
    ("mastered_percent", "Mastered test tasks (%)", "Mastered test tasks over training"),
    ("evaluation_return", "Mean return on the test set", "Return on the test set"),
    ("training_return", "Mean return of training episodes", "Return in training"),
)
"""Column, label of the axis and title of each learning curve."""


@dataclass(frozen=True)
class Picture:
    """A figure of the report.

    Attributes:
        name: file name without its ending.
        png: the file.
        title: what it is, in a few words.
        caption: what is shown, of how many seeds.
        width: its natural width on the page, CSS pixels.
    """

    name: str
    png: bytes
    title: str
    caption: str
    width: int

    @classmethod
    def of(cls, name: str, figure: Figure, title: str, caption: str) -> Picture:
        """Returns `figure` as a picture."""
        return cls(name, png(figure), title, caption, width=round(figure.get_figwidth() * 100))

    @property
    def wide(self) -> bool:
        """Whether it needs the full width of the page."""
        return self.width > 600


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
    plane = task_plane(mine.cells)
    yield from _mastery(frames, mine, plane)
    if plane is not None:
        yield from _curricula(frames, mine, plane)


def _curve_caption(value: str, table: pd.DataFrame) -> str:
    text = f"Lines are means over seeds, bands ± one standard error of the mean; {counts(table)}."
    if (table["status"] == "running").any():
        text += " A line is thin where some of its runs have yet to arrive."
    if value == "training_return":
        if table["smoothed"].any():
            text += f" A run counts with the mean of its latest {RECENT} episodes."
        text += " Each teacher chooses its own training tasks: a low return may mean hard tasks."
    return text


def _mastery(frames: Frames, mine: Measured, plane: tuple[Axis, Axis] | None) -> Iterator[Picture]:
    shares = mastered_tasks(frames, mine.readings)
    for test_set, rows in shares.groupby("test_set"):
        tasks = frames.test_tasks[frames.test_tasks["test_set"] == test_set]
        caption = (
            f"Share of seeds whose last return on the task is over {MASTERY_RETURN:g}, for the {len(tasks)} "
            f"tasks of test set {test_set}; beside each name the mean over tasks; {counts(mine.readings)}."
        )
        figure = mastery_map(rows, tasks, plane)
        yield Picture.of(f"mastery-{test_set}", figure, "Which test tasks are mastered", caption)


def _curricula(frames: Frames, mine: Measured, plane: tuple[Axis, Axis]) -> Iterator[Picture]:
    curricula, seeds = {}, []
    for teacher, run in _examples(mine).items():
        run_id = run["run_id"]
        tables = frames.episodes(run_id), frames.curriculum(run_id), frames.teacher_log(run_id)
        curriculum = Curriculum(*tables, steps=int(run["steps"]))
        if len(curriculum.episodes) and stack(curriculum.episodes["task"]).shape[1] == 2:
            curricula[teacher] = curriculum
            seeds.append(f"{label(teacher)}: seed {run['seed']}")
    if curricula:
        shuffled = any(curriculum.shuffled for curriculum in curricula.values())
        caption = _curriculum_caption(", ".join(seeds), shuffled)
        figure = curriculum_strip(curricula, plane)
        yield Picture.of("curriculum", figure, "Curriculum over training", caption)


def _curriculum_caption(seeds: str, shuffled: bool) -> str:
    text = (
        f"One run of each teacher, the median one by mastered tasks ({seeds}), in {PANELS} equal parts. "
        f"Dots: training episodes, at most {POINTS} a panel, coloured by return; the white line in the scale "
        f"is mastery."
    )
    if shuffled:
        return f"{text} The task space is shuffled: dots show the tasks as they were built."
    return (
        f"{text} Crosses: the last tasks probed without exploration. Outlines: the teacher's last "
        f"Gaussians (two standard deviations, heavier for more weight) or boxes."
    )


def _examples(mine: Measured) -> dict[str, pd.Series]:
    """Returns the run of each teacher that stands for it: the median reading, else its first that runs."""
    cells = mine.cells[mine.cells["status"].isin(["done", "running"])]
    chosen = {}
    for teacher in sorted(cells["teacher"].unique(), key=teacher_order):
        runs = cells[cells["teacher"] == teacher]
        readings = mine.readings[mine.readings["teacher"] == teacher]
        ranked = readings.sort_values(["mastered_percent", "evaluation_return"], kind="stable")["run_id"]
        run_id = ranked.iloc[(len(ranked) - 1) // 2] if len(ranked) else runs["run_id"].iloc[0]
        chosen[teacher] = runs[runs["run_id"] == run_id].iloc[0]
    return chosen


def task_plane(cells: pd.DataFrame) -> tuple[Axis, Axis] | None:
    """Returns the two dimensions that teachers choose from, None where there are more or it is unknown."""
    for spec in cells["spec"].dropna():
        dimensions = parsed(spec).get("task_space", [])
        return (_axis(dimensions[0]), _axis(dimensions[1])) if len(dimensions) == 2 else None
    return None


def _axis(dimension: dict[str, Any]) -> Axis:
    name = str(dimension["name"]).replace("_", " ").capitalize()
    unit = f" ({dimension['unit']})" if dimension["unit"] else ""
    return Axis(name + unit, float(dimension["low"]), float(dimension["high"]))


def counts(rows: pd.DataFrame) -> str:
    """Returns how many runs stand behind each teacher: ``n = 4 seeds``, or one number per teacher."""
    counts = rows.groupby("teacher")["run_id"].nunique()
    usual = int(counts.mode().iloc[-1])
    text = f"n = {usual} seed{'s' if usual > 1 else ''}" + (" per teacher" if len(counts) > 1 else "")
    others = [name for name in sorted(counts.index, key=teacher_order) if counts[name] != usual]
    return ", but ".join(
        [text, *([" and ".join(f"{counts[name]} of {label(name)}" for name in others)] if others else [])]
    )
