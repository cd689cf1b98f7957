"""Results in the shape that tables are made of, from runs of ours and from what others published."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from analysis.data.frames import Frames
from analysis.data.published import paper_frame
from analysis.formatting import amount
from analysis.measures.pooling import pool_runs, pooled, reuse_random
from analysis.measures.run_measures import run_measures
from analysis.measures.student_pools import by_students, without_searches
from analysis.measures.variants import PLUS, parts_of, shipped_together
from tma_ray.benchmark import MATRICES, Matrix
from tma_ray.results import CHIPMUNK
from tma_ray.tasks import MASTERY_RETURN

RESULTS = [
    *("environment", "challenge", "expert_knowledge", "embodiments", "students", "teacher"),
    *("n", "mean", "std", "digits", "missing", "doubt"),
]
"""Columns of results: embodiments and students are sorted tuples of those pooled, mean and std are of
mastered tasks in per cent, digits the decimals that count, missing and doubt as in `table.Cell`."""

APART = ["steps", "engine", "physics_version", "mastery_threshold", "test_set"]
"""Columns of pooled results whose values never share a table; test_set is empty for the shipped ones."""


@dataclass(frozen=True)
class TableResults:
    """Results that may stand in one table.

    Attributes:
        rows: one result each, with the columns `RESULTS`.
        matrices: which bodies and students belong to each challenge.
        name: tells these from other results of the same place in file names; empty for the first.
        remark: of what runs they are, for readers.
    """

    rows: pd.DataFrame
    matrices: tuple[Matrix, ...] = MATRICES
    name: str = ""
    remark: str = ""


def published_table_results(frame: pd.DataFrame | None = None) -> TableResults:
    """Returns published results, those of the paper by default.

    Args:
        frame: in the columns of `published.paper_frame`.
    """
    frame = paper_frame() if frame is None else frame
    steps = " or ".join(amount(steps) for steps in sorted(frame["steps"].unique()))
    engines = " and ".join(sorted(frame["engine"].unique()))
    remark = f"As published, after {steps} steps in worlds of {engines}: to be set beside ours, never pooled."
    return TableResults(results_of(frame), remark=remark)


def table_results(frames: Frames, step: int | None = None) -> list[TableResults]:
    """Returns the results of a root, those apart that no table may hold together.

    Results of students that the paper does not have in a challenge, such as PPO everywhere, stand apart from
    those that pool the paper's. Points of searches for hyper-parameters are left out.

    Args:
        frames: of `load`.
        step: at which runs are read; None for their ends.
    """
    cells, values = without_searches(frames.cells), run_measures(frames, step)
    found: list[TableResults] = []
    for name, matrices, chosen in by_students(cells):
        runs = reuse_random(pool_runs(chosen, values, matrices))
        both = pd.concat([pooled(runs), pooled(runs, by=["embodiment"])], ignore_index=True)
        for remark, rows in _apart(both, step):
            tags = [tag for tag in (name, str(len(found) + 1) if found else "") if tag]
            found.append(TableResults(results_of(rows), matrices, "-".join(tags), remark))
    return found


def results_of(frame: pd.DataFrame) -> pd.DataFrame:
    """Returns the columns `RESULTS` of pooled results or of published ones.

    Args:
        frame: of `pooling.pooled`, some by embodiment or not, or of `published.paper_frame`.
    """
    found = frame.rename(columns={"mastered_percent_mean": "mean", "mastered_percent_std": "std"})
    if "pool" in found:
        parts = [parts_of(pool) for pool in found["pool"]]
        bodies = [{body for body, _ in part} for part in parts]
        alone = found["embodiment"] if "embodiment" in found else [None] * len(found)
        bodies = [
            {body} if isinstance(body, str) else whole for body, whole in zip(alone, bodies, strict=True)
        ]
        students = [{student for _, student in part} for part in parts]
        digits = [1] * len(found)
    else:
        bodies, students = list(found["embodiments"].map(set)), list(found["students"].map(set))
        digits = [1 if round(mean, 1) == mean else 2 for mean in found["mean"]]
    found = found.assign(digits=digits)
    found["embodiments"], found["students"] = _tuples(bodies, found.index), _tuples(students, found.index)
    found = found.assign(**{name: "" for name in ("missing", "doubt") if name not in found})
    # A pool of one body is there twice: whole, and by body.
    key = RESULTS[:6]
    return found[RESULTS].drop_duplicates(key).sort_values(key, ignore_index=True)


def _tuples(sets: Sequence[set[str]], index: pd.Index[Any]) -> pd.Series:
    return pd.Series([tuple(sorted(members)) for members in sets], index=index, dtype=object)


def _apart(frame: pd.DataFrame, step: int | None) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yields groups of results with the same settings, and what to say of each."""
    shipped = shipped_together(frame["environment"].unique())
    places = frame[["engine", "environment", "challenge"]].itertuples(index=False, name=None)
    own = [
        "" if pd.isna(each) or each == PLUS.join(shipped.get(place, ())) else each
        for place, each in zip(places, frame["test_sets"], strict=True)
    ]
    frame = frame.assign(test_set=own)
    for column in APART[:-1]:
        known = frame[column].dropna().unique()
        frame[column] = frame[column].fillna(known[0]) if len(known) == 1 else frame[column]
    groups = list(frame.groupby(APART, dropna=False, sort=True))
    key: Any
    for key, rows in sorted(groups, key=lambda group: -len(group[1])):
        yield _remark(step, key), rows


def _remark(step: int | None, key: tuple[Any, ...]) -> str:
    budget, engine, physics, threshold, test_set = key
    steps = budget if step is None else step
    if pd.isna(budget):
        return "Nothing has begun."
    worlds = f"physics version {physics:g}" if engine == CHIPMUNK else f"worlds of {engine}"
    text = f"After {amount(steps)} steps, {worlds}"
    if threshold != MASTERY_RETURN:
        text += f", tasks mastered over a return of {threshold:g}"
    return f"{text}, test set {test_set}." if test_set else f"{text}."
