"""Runs in cohorts, interrupted and resumed beside others: every kind of student, world and teacher."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from cohort_in_a_thread import serving
from small_runs import SCHEDULE, STUDENTS, data_files, run, small_spec

from tma_ray.runs import Cell, Placement, RunSpec, Schedule, effective_spec

pytestmark = pytest.mark.slow

WIDTH = 3


def forgetting(folder: Path, student: str) -> RunSpec:
    """Return a run whose student forgets twice, under a teacher that trains networks of its own."""
    spec = small_spec(folder, student, "goal_gan")
    return replace(spec, resets=(SCHEDULE.steps // 3, 2 * SCHEDULE.steps // 3))


def asking(folder: Path, student: str) -> RunSpec:
    """Return a run whose teacher asks for values of states."""
    return small_spec(folder, student, "spdl")


def swimming(folder: Path, student: str) -> RunSpec:
    """Return a run of a fish in Parkour."""
    return _walk(folder, student, "parkour", "easy_swimming", "fish")


def diverse(folder: Path, student: str) -> RunSpec:
    """Return a run of a body with other observations and actions."""
    return _walk(folder, student, "stump_tracks", "diverse_students", "spider")


def _walk(folder: Path, student: str, environment: str, challenge: str, body: str) -> RunSpec:
    del folder
    values = {**STUDENTS[student], **({"steps_per_update": 200} if student == "ppo" else {})}
    cell = Cell(environment, challenge, body, student, "random", student_hyperparameters=values)
    return effective_spec(cell, 0, Schedule(2_000, 1_000_000, 1_000, 5, 1_000))


@pytest.mark.parametrize("student", ["ppo", "sac"])
@pytest.mark.parametrize("kind", [forgetting, asking, swimming, diverse])
def test_an_interrupted_run_is_bit_for_bit_one_that_was_not(
    tmp_path: Path, student: str, kind: Callable[[Path, str], RunSpec]
) -> None:
    """First alone in its cohort; then stopped, and resumed beside another learner's other run."""
    spec = kind(tmp_path, student)
    with serving(tmp_path, WIDTH) as learner:
        assert run(spec, tmp_path / "whole", placement=Placement(learner=learner)) == "done"
    neighbour = replace(spec, seed=1)
    for name, stop_after in (("first", 2), ("second", None)):
        (tmp_path / name).mkdir()
        with serving(tmp_path / name, WIDTH) as learner:
            placement = Placement(learner=learner)
            run(neighbour, tmp_path / "neighbour", 1, placement)
            run(spec, tmp_path / "resumed", stop_after, placement)
    assert data_files(tmp_path / "resumed") == data_files(tmp_path / "whole")
