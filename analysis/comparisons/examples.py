"""Runs that stand for the teachers of a comparison, and their curricula."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from analysis.comparisons.measured import Measured
from analysis.data.curricula import Curriculum, curriculum_of, stack
from analysis.data.frames import Frames
from analysis.data.task_axes import task_axes
from analysis.names import teacher_order


def curricula_of(frames: Frames, mine: Measured) -> dict[str, Curriculum]:
    """Returns the curriculum of the run that stands for each teacher, if it has played any episode."""
    size = len(task_axes(mine.cells))
    found = {teacher: curriculum_of(frames, run) for teacher, run in examples_of(mine).items()}
    return {
        teacher: curriculum
        for teacher, curriculum in found.items()
        if len(curriculum.episodes) and stack(curriculum.episodes["task"]).shape[1] == size
    }


def in_whose_space(curricula: Mapping[str, Curriculum]) -> str:
    """Returns a sentence on whose tasks are shown where the task space is shuffled, else nothing."""
    if not any(curriculum.shuffled for curriculum in curricula.values()):
        return ""
    return " The task space is shuffled: axes are the teacher's, not the world's."


def examples_of(mine: Measured) -> dict[str, pd.Series]:
    """Returns each teacher's run of the median final evaluation, else its first run that has begun."""
    cells = mine.cells[mine.cells["status"].isin(["done", "running"])]
    chosen = {}
    for teacher in sorted(cells["teacher"].unique(), key=teacher_order):
        runs = cells[cells["teacher"] == teacher]
        finals = mine.finals[mine.finals["teacher"] == teacher]
        ranked = finals.sort_values(["mastered_percent", "evaluation_return"], kind="stable")["run_id"]
        run_id = ranked.iloc[(len(ranked) - 1) // 2] if len(ranked) else runs["run_id"].iloc[0]
        chosen[teacher] = runs[runs["run_id"] == run_id].iloc[0]
    return chosen
