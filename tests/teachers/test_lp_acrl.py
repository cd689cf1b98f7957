"""LP-ACRL: the grid, the softmax by hand, and what falling returns do."""

from __future__ import annotations

import numpy as np
import pytest
from simulated_play import SPACES, started

from tma_ray.tasks import Episode
from tma_ray.teachers import make_teacher
from tma_ray.teachers.lp_acrl import LPACRL, split_evenly


def lp_acrl(**settings: object) -> LPACRL:
    teacher = started("lp_acrl", SPACES["line"], **settings)
    assert isinstance(teacher, LPACRL)
    return teacher


def report(teacher: LPACRL, x: float, episodic_return: float) -> None:
    task = np.array([x], np.float32)
    teacher.observe(Episode(task, episodic_return, False, 10, np.zeros(1, np.float32), 0.0, 0))


@pytest.mark.parametrize(
    ("dimensions", "cells", "counts"),
    [(1, 36, (36,)), (2, 36, (6, 6)), (3, 36, (4, 3, 3)), (3, 7, (2, 2, 1)), (20, 4, (2, 2, *[1] * 18))],
)
def test_the_grid_is_as_even_as_its_size_allows(dimensions: int, cells: int, counts: tuple[int, ...]) -> None:
    assert split_evenly(dimensions, cells) == counts


def test_chances_are_the_softmax_of_the_change_of_mean_returns() -> None:
    teacher = lp_acrl(cells=3, stage_episodes=4, temperature=20.0)
    for x, gained in ((-0.9, 10), (-0.8, 30), (0.0, 5), (0.9, 100)):
        report(teacher, x, gained)
    np.testing.assert_allclose(teacher.chances_, 1 / 3)  # no stage before the first
    for x, gained in ((-0.9, 50), (-0.8, 70), (0.1, 15), (0.9, 70)):
        report(teacher, x, gained)
    weights = np.exp(np.array([60 - 20, 15 - 5, 70 - 100]) / 20)
    np.testing.assert_allclose(teacher.chances_, weights / weights.sum())
    for x, gained in ((-0.9, 50), (-0.9, 50), (-0.9, 50), (0.9, 90)):
        report(teacher, x, gained)
    weights = np.exp(np.array([50 - 60, 0, 90 - 70]) / 20)  # nothing is known of the middle
    np.testing.assert_allclose(teacher.chances_, weights / weights.sum())
    drawn = (np.digitize(teacher.probe(20_000)[:, 0], [-1 / 3, 1 / 3]) == np.arange(3)[:, None]).mean(axis=1)
    np.testing.assert_allclose(drawn, teacher.chances_, atol=0.01)


def test_a_stage_is_scaled_by_the_square_root_of_the_budget() -> None:
    teacher = lp_acrl(stage_episodes=100, budget=200_000)
    for _ in range(25):
        report(teacher, 0.0, 1.0)
    assert len(teacher.drain_updates()) == 2
    for settings in ({"cells": 1}, {"stage_episodes": 0}, {"temperature": 0.0}, {"budget": 0}):
        with pytest.raises(ValueError, match="expected"):
            make_teacher("lp_acrl", settings)
