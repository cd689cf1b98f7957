"""Kernels against independent formulas, and compiled against plain Python."""

import math

import numpy as np
import pymunk
import pytest

from tma_ray.embodiments import load_embodiment
from tma_ray.envs.stump_tracks import RULES
from tma_ray.physics import LIDAR_RANGE, observation_size
from tma_ray.physics.kernels import (
    GROUND_SIDE,
    command_motors,
    hit_fraction,
    observe,
    shaping,
    step_outcome,
    world_of,
)
from tma_ray.physics.rules import step_arrays
from tma_ray.terrain import GROUND_HEIGHT
from tma_ray.terrain.stump_tracks import stump_tracks

BODY = load_embodiment("classic_bipedal")
ARRAYS = step_arrays(BODY, RULES)
GOAL = 88.0
NOTHING = np.zeros((5, 2), dtype=np.int64)
AGES, NO_GRIPS = np.zeros(2, dtype=np.int64), np.zeros((0, 2), dtype=np.int64)


def state_at(x: float = 5.0, y: float = 6.0, angle: float = 0.0) -> np.ndarray:
    state = np.random.default_rng(3).normal(size=(5, 6))
    state[0, :3] = x, y, angle
    return state


def touching(parts: dict[int, tuple[int, int]]) -> np.ndarray:
    contacts = NOTHING.copy()
    for part, counts in parts.items():
        contacts[part] = counts
    return contacts


@pytest.mark.parametrize("task", [(0.0, 0.0), (1.5, 0.0), (1.5, 3.0), (3.0, 1.0), (9.0, 0.5), (0.0, 6.0)])
def test_lidars_see_what_segment_queries_of_chipmunk_see(task: tuple[float, float]) -> None:
    rng = np.random.default_rng(7)
    terrain = stump_tracks(np.array(task, dtype=np.float32), rng)
    space = pymunk.Space()
    space.add(*[pymunk.Poly(space.static_body, corners) for corners in terrain.solids.tolist()])
    top = terrain.solids[:, 2, 1].max()
    compared = 0
    while compared < 1000:
        x, y = rng.uniform(0, 90), rng.uniform(GROUND_HEIGHT, top + 4)
        if space.point_query((x, y), 1e-3, pymunk.ShapeFilter()):
            continue
        ray = LIDAR_RANGE * np.array([np.sin(angle := rng.uniform(-np.pi, np.pi)), -np.cos(angle)])
        hit = space.segment_query_first((x, y), (x + ray[0], y + ray[1]), 0, pymunk.ShapeFilter())
        expected = 1.0 if hit is None else hit.alpha
        assert hit_fraction(x, y, ray, terrain.surface, GROUND_SIDE) == pytest.approx(expected, abs=1e-9)
        compared += 1


def test_a_lidar_inside_a_solid_does_not_see_it() -> None:
    terrain = stump_tracks(np.array([3.0, 3.0], dtype=np.float32), np.random.default_rng(0))
    left, top = terrain.solids[1, 0, 0], terrain.solids[1, 2, 1]
    forward = np.array([1.0, 0.0])
    assert hit_fraction(left - 0.1, top - 0.5, forward, terrain.surface, GROUND_SIDE) == pytest.approx(0.1)
    assert hit_fraction(left + 0.1, top - 0.5, forward, terrain.surface, GROUND_SIDE) == 1.0


def test_motors_get_the_sign_as_speed_and_the_size_as_torque() -> None:
    commands = np.zeros((4, 2))
    cost = command_motors(np.array([0.5, -0.25, 0.0, -3.0]), True, ARRAYS, commands)
    assert commands.tolist() == [[4.0, 40.0], [-6.0, 20.0], [0.0, 0.0], [-6.0, 80.0]]
    assert cost == pytest.approx(0.00035 * 80 * (0.5 + 0.25 + 0 + 1))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_motors_refuse_actions_that_are_not_finite(bad: float) -> None:
    assert math.isnan(command_motors(np.array([0.0, 0.0, bad, 0.0]), True, ARRAYS, np.zeros((4, 2))))


def test_observation_follows_the_releases_layout() -> None:
    terrain = stump_tracks(np.array([1.0, 2.0], dtype=np.float32), np.random.default_rng(0))
    state, contacts = state_at(angle=0.3), np.array([[0, 0], [1, 0], [1, 1], [0, 0], [0, 0]])
    observation = np.empty(observation_size(ARRAYS), dtype=np.float32)
    observe(state, contacts, AGES, NO_GRIPS, ARRAYS, world_of(terrain), observation)
    angle, velocity_x, velocity_y, spin = state[:, 2], state[0, 3], state[0, 4], state[:, 5]
    expected = [angle[0], 2 * spin[0] / 50, 0.3 * velocity_x * 20 / 50, 0.3 * velocity_y * (400 / 30) / 50]
    for upper, lower, contact in ((1, 2, 1.0), (3, 4, 0.0)):
        expected += [angle[upper] - angle[0], (spin[upper] - spin[0]) / 4]
        expected += [angle[lower] - angle[upper] + 1, (spin[lower] - spin[upper]) / 6, contact]
    assert observation[:14] == pytest.approx(expected, rel=1e-6)
    height = (state[0, 1] - GROUND_HEIGHT) / (160 / 30)
    assert observation[14] == pytest.approx(height, rel=1e-6)
    assert observation[15] == pytest.approx(height / math.cos(0.15), rel=1e-6)
    assert len(observation) == 24


def test_reward_is_progress_less_tilt_and_cost() -> None:
    before, after = state_at(5.0, angle=-0.2), state_at(5.3, angle=0.1)
    reward, ended, potential = step_outcome(after, NOTHING, ARRAYS, GOAL, 0.02, shaping(before, ARRAYS))
    assert reward == pytest.approx(130 / 30 * 0.3 + 5 * (0.2 - 0.1) - 0.02)
    assert not ended
    assert potential == shaping(after, ARRAYS)


def test_the_head_touching_anything_is_a_fall_and_so_is_leaving_the_track_backwards() -> None:
    assert step_outcome(state_at(-0.01), NOTHING, ARRAYS, GOAL, 0.0, 0.0)[:2] == (-100.0, True)
    reward, ended, _ = step_outcome(state_at(), touching({0: (1, 0)}), ARRAYS, GOAL, 0.0, 0.0)
    assert (reward, ended) == (-100.0, True)
    legs = touching({1: (3, 0), 2: (1, 2), 3: (1, 0), 4: (0, 1)})
    _, ended, _ = step_outcome(state_at(), legs, ARRAYS, GOAL, 0.0, 0.0)
    assert not ended


def test_the_goal_ends_the_episode_and_keeps_the_reward() -> None:
    before = shaping(state_at(GOAL - 0.1), ARRAYS)
    reward, ended, _ = step_outcome(state_at(GOAL + 0.1), NOTHING, ARRAYS, GOAL, 0.0, before)
    assert ended
    assert reward == pytest.approx(130 / 30 * 0.2)
    assert not step_outcome(state_at(GOAL), NOTHING, ARRAYS, GOAL, 0.0, before)[1]
