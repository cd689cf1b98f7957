"""LP-ACRL: the grid, the softmax by hand, and what falling returns do."""

from __future__ import annotations

import numpy as np
import pytest
from simulated_play import SPACES, ended, started

from tma_ray.teachers.lp_acrl import split_evenly


@pytest.mark.parametrize(
    ("dimensions", "cells", "counts"),
    [(1, 36, (36,)), (2, 36, (6, 6)), (3, 36, (4, 3, 3)), (3, 7, (2, 2, 1)), (20, 4, (2, 2, *[1] * 18))],
)
def test_the_grid_is_as_even_as_its_size_allows(dimensions: int, cells: int, counts: tuple[int, ...]) -> None:
    assert split_evenly(dimensions, cells) == counts


def test_chances_are_the_softmax_of_the_change_of_mean_returns() -> None:
    teacher = started("lp_acrl", SPACES["line"], cells=3, stage_episodes=4, temperature=20.0)
    for stage, changes in (
        (((-0.9, 10), (-0.8, 30), (0.0, 5), (0.9, 100)), [0, 0, 0]),  # no stage before the first
        (((-0.9, 50), (-0.8, 70), (0.1, 15), (0.9, 70)), [60 - 20, 15 - 5, 70 - 100]),
        (((-0.9, 50), (-0.9, 50), (-0.9, 50), (0.9, 90)), [50 - 60, 0, 90 - 70]),  # no news of the middle
    ):
        for x, gained in stage:
            teacher.observe(ended([x], gained))
        weights = np.exp(np.array(changes) / 20)
        np.testing.assert_allclose(teacher.chances_, weights / weights.sum())
    drawn = (np.digitize(teacher.probe(20_000)[:, 0], [-1 / 3, 1 / 3]) == np.arange(3)[:, None]).mean(axis=1)
    np.testing.assert_allclose(drawn, teacher.chances_, atol=0.01)
