"""Pools of runs where students, or a body of the original release, stand in for the paper's."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pandas as pd

from analysis.data.frames import Frames, computed_once
from analysis.data.identity import of_searches
from analysis.measures.pooling import POOLED, pool_members, reuse_random, with_values
from analysis.measures.run_measures import run_measures
from analysis.measures.variants import BIPEDAL, RELEASED_BIPEDAL
from tma_ray.benchmark import MATRICES, Matrix
from tma_ray.results import BOX2D

RELEASED_MATRICES = tuple(
    replace(
        matrix,
        embodiments=tuple(RELEASED_BIPEDAL if body == BIPEDAL else body for body in matrix.embodiments),
    )
    for matrix in MATRICES
)
"""The paper's matrices with the bodies that the original release ran."""


def runs_after(frames: Frames, share: float = 1.0, *, training: bool = True) -> pd.DataFrame:
    """Returns `result_runs` after a share of the budget of each run; 1 for the ends of runs.

    Args:
        frames: what was run.
        share: of each run's own budget.
        training: of `run_measures`.
    """
    return _runs_after(frames, share, training)


@computed_once
def _runs_after(frames: Frames, share: float, training: bool) -> pd.DataFrame:
    return result_runs(frames, run_measures(frames, share=share, training=training))


def result_runs(frames: Frames, values: pd.DataFrame) -> pd.DataFrame:
    """Returns all runs that count as results, in the pools they belong to, with Random at every level.

    Where only students run that the paper does not have there, such as PPO everywhere, these are the pool.
    One rule for all readers.

    Args:
        frames: what was run.
        values: measures by run_id, as from `run_measures` or `evaluations_at`.

    Returns:
        Of `pooling.pool_runs`.
    """
    return with_values(_members(frames), values)


@computed_once
def _members(frames: Frames) -> pd.DataFrame:
    """Returns which runs are results of which pools: the same whatever is measured of them, and when."""
    groups = by_students(without_searches(frames.cells))
    parts = [pool_members(chosen, matrices) for _, matrices, chosen in groups]
    members = pd.concat(parts, ignore_index=True).drop_duplicates([*POOLED, "run_id"])
    return reuse_random(members.reset_index(drop=True))


def without_searches(cells: pd.DataFrame) -> pd.DataFrame:
    """Returns `cells` without points of searches for hyper-parameters."""
    return cells[~of_searches(cells["experiment"])]


def by_students(cells: pd.DataFrame) -> Iterator[tuple[str, tuple[Matrix, ...], pd.DataFrame]]:
    """Yields the paper's students together, then each other one alone, with the matrices to pool by.

    Results of the original release, whose bipedal is another one, stand apart from others in the same root.
    """
    imported = (cells["engine"] == BOX2D).to_numpy(bool)
    if not (imported & (cells["embodiment"] == RELEASED_BIPEDAL).to_numpy(bool)).any():
        yield from _by_students(cells, MATRICES)
        return
    if not imported.all():
        yield from _by_students(cells[~imported], MATRICES)
    for name, matrices, chosen in _by_students(cells[imported], RELEASED_MATRICES):
        apart = "" if imported.all() else _file_name(BOX2D)
        yield "-".join(tag for tag in (name, apart) if tag), matrices, chosen


def _by_students(
    cells: pd.DataFrame, matrices: tuple[Matrix, ...]
) -> Iterator[tuple[str, tuple[Matrix, ...], pd.DataFrame]]:
    theirs = {(m.environment, m.challenge): m.students for m in MATRICES}
    places = zip(cells["environment"], cells["challenge"], cells["student"], strict=True)
    other = {
        student for *place, student in places if student not in theirs.get((place[0], place[1]), (student,))
    }
    if not set(cells["student"]) or set(cells["student"]) - other:
        yield "", matrices, cells
    for student in sorted(other):
        alone = tuple(replace(matrix, students=(student,)) for matrix in matrices)
        yield _file_name(student), alone, cells[cells["student"] == student]


def _file_name(text: str) -> str:
    return "".join(character if character.isalnum() else "-" for character in text.lower()).strip("-")
