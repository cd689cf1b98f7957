"""Figures of the curricula of one comparison, by one run of each teacher."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import pandas as pd

from analysis.comparison import Measured
from analysis.curriculum import Curriculum, stack
from analysis.dimensions import dimension_bands
from analysis.frames import Frames
from analysis.picture import Picture
from analysis.scalars import MOST_PER_TEACHER, scalar_curves, scalars_of
from analysis.style import label, teacher_order
from analysis.task_axes import Axis, task_axes
from analysis.teacher_view import moments

LARGEST = 20
"""Spaces with more varied dimensions are not drawn."""


def curriculum_pictures(mine: Measured, curricula: Mapping[str, Curriculum]) -> Iterator[Picture]:
    """Yields the figures of `curricula_of` over the whole run: by dimension, and what teachers log."""
    axes, examples = task_axes(mine.cells), examples_of(mine)
    if not curricula:
        return
    seeds = ", ".join(f"{label(teacher)}: seed {examples[teacher]['seed']}" for teacher in curricula)
    which = f"One run of each teacher, the median one by mastered tasks ({seeds})"
    varied = sum(axis.low < axis.high for axis in axes)
    probed = {teacher: each for teacher, each in curricula.items() if len(each.probes)}
    whole_plane = len(axes) == varied == 2  # which charts show step by step
    if 0 < varied <= LARGEST and not whole_plane and len(moments(probed)) > 1:
        yield _dimensions(probed, axes, which)
    figure = scalar_curves(curricula)
    if figure is not None:
        yield Picture.of("teacher-scalars", figure, "What teachers log", _scalars_caption(curricula, which))


def curricula_of(frames: Frames, mine: Measured) -> dict[str, Curriculum]:
    """Returns the curriculum of the run that stands for each teacher, if it has played any episode."""
    size = len(task_axes(mine.cells))
    found = {teacher: curriculum_of(frames, run) for teacher, run in examples_of(mine).items()}
    return {
        teacher: curriculum
        for teacher, curriculum in found.items()
        if len(curriculum.episodes) and stack(curriculum.episodes["task"]).shape[1] == size
    }


def curriculum_of(frames: Frames, run: pd.Series) -> Curriculum:
    """Returns what there is of the curriculum of one run, a row of `Frames.cells`."""
    run_id = run["run_id"]
    tables = frames.episodes(run_id), frames.curriculum(run_id), frames.teacher_log(run_id)
    return Curriculum(*tables, steps=int(run["steps"]), mastery=float(run["mastery_threshold"]))


def _dimensions(curricula: Mapping[str, Curriculum], axes: tuple[Axis, ...], which: str) -> Picture:
    caption = (
        f"{which}. Of the tasks probed without exploration: median, middle half and middle 90 %, "
        f"dimension by dimension. Dark lines: bounds of the teacher's box, or two standard deviations "
        f"around its Gaussian; dots: means of several Gaussians, larger for more weight."
    )
    constant = sum(axis.low == axis.high for axis in axes)
    if constant:
        caption += f" {constant} constant dimension{'s are' if constant > 1 else ' is'} left out."
    return Picture.of(
        "curriculum-dimensions",
        dimension_bands(curricula, axes),
        "Curriculum over training, dimension by dimension",
        caption + in_whose_space(curricula),
    )


def _scalars_caption(curricula: Mapping[str, Curriculum], which: str) -> str:
    text = (
        f"{which}: figures that teachers log at their updates; bands show the range where points are dense."
    )
    hidden = sum(max(0, len(scalars_of(each)) - MOST_PER_TEACHER) for each in curricula.values())
    return text + (f" {hidden} more are in the table teacher_log." if hidden else "")


def in_whose_space(curricula: Mapping[str, Curriculum]) -> str:
    """Returns a sentence on whose tasks are shown where the task space is shuffled, else nothing."""
    if not any(curriculum.shuffled for curriculum in curricula.values()):
        return ""
    return " The task space is shuffled: axes are the teacher's, not the world's."


def examples_of(mine: Measured) -> dict[str, pd.Series]:
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
