"""Measurements of a root, whole or for one comparison of teachers, and its median runs."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
import pandas as pd

from analysis.comparisons.frame import Randoms, against_baseline, randoms_of
from analysis.data.columns import COMPARISON
from analysis.data.curricula import Curriculum, curricula_of_runs, stack, task_axes
from analysis.data.frames import Frames
from analysis.formatting import listed
from analysis.measures.evaluations import evaluation_curves, final_evaluations, summarise, training_curves
from analysis.measures.tested import HEADLINE, MEASURES
from analysis.names import challenge_title, label, teacher_order
from tma_ray.support.component_names import split_name

TESTED = tuple(MEASURES)
"""Measures that are tested against Random, the headline first."""


@dataclass(frozen=True, eq=False)
class Measured:
    """Frames of measures, all with the columns of `columns.COMPARISON`.

    Attributes:
        cells: cells of `Frames`.
        finals: one row per run, of `evaluations.final_evaluations`.
        summary: one row per teacher, of `evaluations.summarise`.
        tests: one row per teacher and each of `TESTED`, of `frame.against_baseline`.
        evaluations: one row per run and evaluation, of `evaluations.evaluation_curves`.
        training: returns in training, of `evaluations.training_curves`.
    """

    cells: pd.DataFrame
    finals: pd.DataFrame
    summary: pd.DataFrame
    tests: pd.DataFrame
    evaluations: pd.DataFrame
    training: pd.DataFrame

    @cached_property
    def randoms(self) -> Randoms:
        """The evaluations of Random, of `randoms_of`."""
        return randoms_of(self.evaluations)

    @cached_property
    def comparisons(self) -> tuple["Measured", ...]:
        """The part of each comparison, in a fixed order."""
        tables = [getattr(self, field.name) for field in fields(self)]
        parts = [dict(list(table.groupby(COMPARISON))) if len(table) else {} for table in tables]
        keys = self.cells[COMPARISON].drop_duplicates().sort_values(COMPARISON)
        return tuple(
            Measured(*(mine.get(key, table.head(0)) for mine, table in zip(parts, tables, strict=True)))
            for key in keys.itertuples(index=False, name=None)
        )


def measure(frames: Frames) -> Measured:
    """Return everything that is measured of a root."""
    finals, evaluations = final_evaluations(frames), evaluation_curves(frames)
    tests = [against_baseline(finals, evaluations, name) for name in TESTED]
    return Measured(
        cells=frames.cells,
        finals=finals,
        summary=summarise(frames, finals),
        tests=pd.concat(tests, ignore_index=True),
        evaluations=evaluations,
        training=training_curves(frames),
    )


def curricula_of(
    frames: Frames, mine: Measured, runs: Mapping[str, pd.Series] | None = None
) -> dict[str, Curriculum]:
    """Return the curriculum of each teacher's median run, or of `runs`, if it has any episode."""
    size = len(task_axes(mine.cells))
    examples = examples_of(mine) if runs is None else runs
    found = zip(examples, curricula_of_runs(frames, list(examples.values())), strict=True)
    return {
        teacher: curriculum
        for teacher, curriculum in found
        if len(curriculum.episodes) and stack(curriculum.episodes["task"]).shape[1] == size
    }


def which_runs(curricula: Mapping[str, Curriculum]) -> str:
    """Return the seed of each teacher's median run, in words."""
    named = listed(f"{label(teacher)}: seed {each.seed}" for teacher, each in curricula.items())
    return f"One run of each teacher, the median one by mastered tasks over training ({named})"


def in_whose_space(curricula: Mapping[str, Curriculum]) -> str:
    """Return a sentence on the space of the tasks shown if the task space is shuffled, else nothing."""
    shuffled = any(curriculum.shuffled for curriculum in curricula.values())
    return " The task space is shuffled: axes are the teacher's, not the world's." if shuffled else ""


def examples_of(mine: Measured) -> dict[str, pd.Series]:
    """Return the run of each teacher with the median headline, else its first run that has begun."""
    cells = mine.cells[mine.cells["status"].isin(["done", "running"])]
    ranked = mine.finals.sort_values([HEADLINE, "evaluation_return"], kind="stable")
    finals = {str(teacher): rows.to_numpy(object) for teacher, rows in ranked.groupby("teacher")["run_id"]}
    begun = {str(teacher): runs for teacher, runs in cells.groupby("teacher")}
    chosen = {}
    for teacher in sorted(begun, key=teacher_order):
        runs = begun[teacher]
        run_ids = runs["run_id"].to_numpy(object)
        best = finals.get(teacher, run_ids[:1])
        chosen[teacher] = runs.iloc[int(np.argmax(run_ids == best[(len(best) - 1) // 2]))]
    return chosen


def titled(measured: Measured) -> Iterator[tuple[str, str, Measured]]:
    """Yield the anchor, title and part of each comparison of the root, in a fixed order."""
    several_engines = measured.cells["engine"].nunique() > 1
    titles = []
    for mine in measured.comparisons:
        cell = mine.cells.iloc[0]
        environment, plain = label(cell["environment"]), label(split_name(cell["environment"])[0])
        challenge = challenge_title(cell["environment"], cell["challenge"], cell["challenge"])
        own = challenge[:1].lower() + challenge[1:]
        parts = [
            challenge if challenge.startswith(plain) else f"{environment}, {own}",
            cell["embodiment"].replace("_", " "),
            label(cell["student"]),
            f"expert knowledge {cell['expert_knowledge']}",
            cell["engine"] if several_engines else "",
        ]
        titles.append(", ".join(filter(None, parts)))
    for count, (heading, mine) in enumerate(zip(titles, measured.comparisons, strict=True), start=1):
        experiment = f"{mine.cells.iloc[0]['experiment']}, " if titles.count(heading) > 1 else ""
        yield f"comparison-{count}", f"{experiment}{heading}", mine
