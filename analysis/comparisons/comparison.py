"""Measurements of a root, and comparisons of its teachers under the same conditions."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from analysis.comparisons.pairwise import Randoms, against_baseline, randoms_of, reference_of
from analysis.data.columns import COMPARISON
from analysis.data.curricula import Axis, RunCurriculum, curricula_of_runs, stack, task_axes
from analysis.data.frames import Frames
from analysis.data.reference import is_baseline
from analysis.measures.evaluations import (
    ceiling_percent,
    evaluation_curves,
    final_evaluations,
    summarise,
    training_curves,
)
from analysis.measures.tested import HEADLINE, MEASURES
from analysis.names import challenge_title, label, teacher_order
from tma_ray.support.component_names import base_name

ALL_SHOWN = 12  # a page with at most this many teachers initially shows all of them

MOST_SHOWN = 8  # a page with more teachers initially shows this many besides Random


@dataclass(frozen=True, eq=False)
class Measurements:
    """Measurements of all runs of a root, in tables with the columns `COMPARISON`."""

    frames: Frames  # results of the root

    @property
    def cells(self) -> pd.DataFrame:
        """Cells, as in `Frames`."""
        return self.frames.cells

    @cached_property
    def finals(self) -> pd.DataFrame:
        """One row per run, from `evaluations.final_evaluations`."""
        return final_evaluations(self.frames)

    @cached_property
    def summary(self) -> pd.DataFrame:
        """One row per teacher, from `evaluations.summarise`."""
        return summarise(self.frames, self.finals)

    @cached_property
    def tests(self) -> pd.DataFrame:
        """One row per teacher and measure, headline first, from `pairwise.against_baseline`."""
        return against_baseline(self.finals, self.evaluations, MEASURES)

    @cached_property
    def evaluations(self) -> pd.DataFrame:
        """One row per run and evaluation, from `evaluations.evaluation_curves`."""
        return evaluation_curves(self.frames)

    @cached_property
    def training(self) -> pd.DataFrame:
        """Training returns, from `evaluations.training_curves`."""
        return training_curves(self.frames)

    @cached_property
    def randoms(self) -> Randoms:
        """Evaluations of Random, from `randoms_of`."""
        return randoms_of(self.evaluations)

    @cached_property
    def shown(self) -> frozenset[str]:
        """Teachers that a page initially shows."""
        return leading(self.finals, HEADLINE, self.cells["teacher"], COMPARISON)

    @property
    def comparisons(self) -> tuple["TeacherComparison", ...]:
        """Comparisons in a fixed order, new ones on each access so that cached curricula can be freed."""
        return tuple(TeacherComparison(measurements=self, **parts) for parts in self._parts)

    @cached_property
    def _parts(self) -> list[dict[str, Any]]:
        names = ("cells", "finals", "summary", "tests", "evaluations", "training")
        tables: dict[str, pd.DataFrame] = {name: getattr(self, name) for name in names}
        groups = {
            name: dict(list(table.groupby(COMPARISON))) if len(table) else {}
            for name, table in tables.items()
        }
        keys = self.cells[COMPARISON].drop_duplicates().sort_values(COMPARISON)
        parts: list[dict[str, Any]] = [
            {name: groups[name].get(key, table.head(0)) for name, table in tables.items()}
            for key in keys.itertuples(index=False, name=None)
        ]
        titles = _titles([part["cells"].iloc[0] for part in parts])
        for number, (part, title) in enumerate(zip(parts, titles, strict=True), start=1):
            part |= {"anchor": f"comparison-{number}", "title": title}
        return parts


@dataclass(frozen=True, eq=False)
class TeacherComparison:
    """Teachers compared under the same conditions: rows of `Measurements` with one value of `COMPARISON`."""

    anchor: str  # identifier on a page
    title: str  # title, unique among the comparisons of the root
    cells: pd.DataFrame  # cells, as in `Frames`
    finals: pd.DataFrame  # one row per run
    summary: pd.DataFrame  # one row per teacher
    tests: pd.DataFrame  # one row per teacher and measure
    evaluations: pd.DataFrame  # one row per run and evaluation
    training: pd.DataFrame  # training returns
    measurements: Measurements = field(repr=False)  # measurements of the whole root

    @property
    def frames(self) -> Frames:
        """Results of the root."""
        return self.measurements.frames

    @cached_property
    def axes(self) -> tuple[Axis, ...]:
        """Dimensions of the task space."""
        return task_axes(self.cells)

    @cached_property
    def ceiling(self) -> float | None:
        """Percentage of the environment's test tasks that at least one run masters; see `ceiling_percent`."""
        return ceiling_percent(self.frames, str(self.cells["environment"].iloc[0]))

    @cached_property
    def reference(self) -> pd.DataFrame:
        """Evaluations of Random, taken from another level or experiment if Random has none here."""
        return reference_of(self.evaluations, self.measurements.randoms)

    @cached_property
    def median_runs(self) -> dict[str, pd.Series]:
        """Each teacher's run with the median of `HEADLINE`, or its first started run if none has a value."""
        cells = self.cells[self.cells["status"].isin(["done", "running"])]
        ranked = self.finals.sort_values([HEADLINE, "evaluation_return"], kind="stable")
        finals = {
            str(teacher): rows.to_numpy(object) for teacher, rows in ranked.groupby("teacher")["run_id"]
        }
        begun = {str(teacher): runs for teacher, runs in cells.groupby("teacher")}
        chosen = {}
        for teacher in sorted(begun, key=teacher_order):
            runs = begun[teacher]
            run_ids = runs["run_id"].to_numpy(object)
            by_headline = finals.get(teacher, run_ids[:1])
            median = by_headline[(len(by_headline) - 1) // 2]
            chosen[teacher] = runs.iloc[int(np.argmax(run_ids == median))]
        return chosen

    @cached_property
    def curricula(self) -> dict[str, RunCurriculum]:
        """Curricula of the teachers' median runs, leaving out runs without episodes."""
        return self.read_curricula(self.median_runs)

    def read_curricula(self, teachers: Iterable[str]) -> dict[str, RunCurriculum]:
        """Return the curricula of the given teachers' median runs, leaving out runs without episodes."""
        runs = {teacher: self.median_runs[teacher] for teacher in teachers}
        curricula = zip(runs, curricula_of_runs(self.frames, list(runs.values())), strict=True)
        return {
            teacher: curriculum
            for teacher, curriculum in curricula
            if len(curriculum.episodes) and stack(curriculum.episodes["task"]).shape[1] == len(self.axes)
        }


def _titles(cells: Sequence[pd.Series]) -> list[str]:
    """Return the titles of comparisons, prefixed by the experiment if they would otherwise be ambiguous."""
    several_engines = len({cell["engine"] for cell in cells}) > 1
    titles = []
    for cell in cells:
        environment, plain = label(cell["environment"]), label(base_name(cell["environment"]))
        challenge = challenge_title(cell["environment"], cell["challenge"], cell["challenge"])
        parts = [
            challenge
            if challenge.startswith(plain)
            else f"{environment}, {challenge[:1].lower()}{challenge[1:]}",
            cell["embodiment"].replace("_", " "),
            label(cell["student"]),
            f"expert knowledge {cell['expert_knowledge']}",
            cell["engine"] if several_engines else "",
        ]
        titles.append(", ".join(filter(None, parts)))
    counts = Counter(titles)
    return [
        f"{cell['experiment']}, {title}" if counts[title] > 1 else title
        for cell, title in zip(cells, titles, strict=True)
    ]


def leading(
    results: pd.DataFrame, measure: str, teachers: Iterable[object], within: Sequence[str] = ()
) -> frozenset[str]:
    """Return the teachers that a page initially shows: all, or Random and the best if there are many.

    The best have the highest means of a measure over their challenges. A comparison without any of them
    shows its best teacher.

    Args:
        results: a row for each teacher and challenge, with the columns teacher and `measure`.
        measure: column of `results`; NaN for missing results.
        teachers: all teachers of the page, also those without results yet.
        within: columns that the teachers of a comparison have in common.
    """
    everyone = frozenset(map(str, teachers))
    if len(everyone) <= ALL_SHOWN:
        return everyone
    means = results.groupby("teacher")[measure].mean().sort_values(ascending=False, kind="stable")
    others = [str(teacher) for teacher in means.index if not is_baseline(str(teacher))]
    shown = {*others[:MOST_SHOWN], *(str(teacher) for teacher in means.index if is_baseline(str(teacher)))}
    if within:
        best = results.dropna(subset=[measure]).sort_values(measure, ascending=False, kind="stable")
        for _, rows in best.groupby(list(within), dropna=False, sort=True):
            if shown.isdisjoint(rows["teacher"]):
                shown.add(str(rows["teacher"].iloc[0]))
    return frozenset(shown)
