"""Stump Tracks' world: where stumps stand, how high they are, and what the lidars see."""

import numpy as np
import pytest

from tma_ray.terrain import GROUND_HEIGHT
from tma_ray.terrain.stump_tracks import GOAL_X, MINIMUM_STUMP_HEIGHT, TRACK_LENGTH, stump_tracks
from tma_ray.terrain.terrain import TERRAIN_STEP

TASKS = [(0.0, 0.0), (0.0, 6.0), (1.5, 3.0), (3.0, 1.0), (9.0, 0.0), (9.0, 6.0), (-3.0, 2.0)]


def world(height: float, spacing: float, seed: int = 0):
    return stump_tracks(np.array([height, spacing], dtype=np.float32), np.random.default_rng(seed))


def stumps(height: float, spacing: float, seed: int = 0):
    solids = world(height, spacing, seed).solids[1:]
    return solids[:, 0, 0], solids[:, 1, 0], (solids[:, 2, 1] - GROUND_HEIGHT) / TERRAIN_STEP


@pytest.mark.parametrize("task", TASKS)
def test_stumps_stand_at_the_tasks_spacing_from_the_startpad_on(task: tuple[float, float]) -> None:
    left, right, _ = stumps(*task)
    assert left[0] == pytest.approx(20 * TERRAIN_STEP)
    assert right - left == pytest.approx(TERRAIN_STEP)
    assert left[1:] - right[:-1] == pytest.approx(max(0.01, task[1]), abs=1e-6)
    assert right[-1] <= TRACK_LENGTH < right[-1] + max(0.01, task[1]) + TERRAIN_STEP


@pytest.mark.parametrize("mean", [0.5, 1.5, 9.0])
def test_heights_are_normal_around_the_mean(mean: float) -> None:
    heights = np.concatenate([stumps(mean, 0.0, seed)[2] for seed in range(20)])
    assert heights.mean() == pytest.approx(mean, abs=4 * 0.1 / np.sqrt(len(heights)))
    assert heights.std() == pytest.approx(0.1, rel=0.1)


def test_a_negative_mean_counts_as_zero() -> None:
    low, zero = stumps(-3.0, 1.0)[2], stumps(0.0, 1.0)[2]
    np.testing.assert_array_equal(low, zero)
    assert zero.min() == pytest.approx(MINIMUM_STUMP_HEIGHT)
    assert zero.max() > MINIMUM_STUMP_HEIGHT  # drawn, not cut to the minimum


@pytest.mark.parametrize("task", TASKS)
def test_ground_reaches_past_the_goal_and_every_lidar(task: tuple[float, float]) -> None:
    terrain = world(*task)
    ground = terrain.solids[0]
    assert ground[:, 0].min() < -10
    assert ground[:, 0].max() > GOAL_X + 10
    assert terrain.goal_x == pytest.approx(88.6667, abs=1e-3)
    assert terrain.spawn == pytest.approx([4.66667, GROUND_HEIGHT], abs=1e-4)


@pytest.mark.parametrize("task", TASKS)
def test_the_surface_is_one_line_from_end_to_end_over_all_solids(task: tuple[float, float]) -> None:
    terrain = world(*task)
    surface = terrain.surface
    np.testing.assert_array_equal(surface[1:, :2], surface[:-1, 2:])
    assert np.all(np.diff(surface[:, 0]) >= 0)
    assert np.all(np.diff(surface[:, 2]) >= 0)
    for x in np.random.default_rng(1).uniform(0, TRACK_LENGTH, 200):
        inside = (terrain.solids[:, 0, 0] < x) & (x < terrain.solids[:, 1, 0])
        flat = (surface[:, 0] < x) & (x < surface[:, 2])
        assert surface[flat, 1].max() == terrain.solids[inside, 2, 1].max()
