"""Runs that stand for the teachers of a comparison, and their curricula."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from analysis.comparisons.measured import Measured
from analysis.data.curricula import Curriculum, curricula_of_runs, stack
from analysis.data.frames import Frames
from analysis.data.task_axes import task_axes
from analysis.formatting import listed
from analysis.names import label, teacher_order


def curricula_of(
    frames: Frames, mine: Measured, runs: Mapping[str, pd.Series] | None = None
) -> dict[str, Curriculum]:
    """Returns the curriculum of the run that stands for each teacher, if it has played any episode.

    Args:
        frames: of the root.
        mine: of the comparison.
        runs: of `examples_of`, or some of them; all by default.
    """
    size = len(task_axes(mine.cells))
    examples = examples_of(mine) if runs is None else runs
    found = curricula_of_runs(frames, list(examples.values()))
    return {
        teacher: curriculum
        for teacher, curriculum in zip(examples, found, strict=True)
        if len(curriculum.episodes) and stack(curriculum.episodes["task"]).shape[1] == size
    }


def which_runs(curricula: Mapping[str, Curriculum]) -> str:
    """Returns which run stands for each teacher, in words."""
    named = listed(f"{label(teacher)}: seed {each.seed}" for teacher, each in curricula.items())
    return f"One run of each teacher, the median one by mastered tasks ({named})"


def in_whose_space(curricula: Mapping[str, Curriculum]) -> str:
    """Returns a sentence on whose tasks are shown where the task space is shuffled, else nothing."""
    if not any(curriculum.shuffled for curriculum in curricula.values()):
        return ""
    return " The task space is shuffled: axes are the teacher's, not the world's."


def examples_of(mine: Measured) -> dict[str, pd.Series]:
    """Returns each teacher's run of the median final evaluation, else its first run that has begun."""
    cells = mine.cells[mine.cells["status"].isin(["done", "running"])]
    ranked = mine.finals.sort_values(["mastered_percent", "evaluation_return"], kind="stable")
    finals = {str(teacher): rows.to_numpy(object) for teacher, rows in ranked.groupby("teacher")["run_id"]}
    begun = {str(teacher): runs for teacher, runs in cells.groupby("teacher")}
    chosen = {}
    for teacher in sorted(begun, key=teacher_order):
        runs = begun[teacher]
        run_ids = runs["run_id"].to_numpy(object)
        best = finals.get(teacher, run_ids[:1])
        chosen[teacher] = runs.iloc[int(np.argmax(run_ids == best[(len(best) - 1) // 2]))]
    return chosen
