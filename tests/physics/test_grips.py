"""What grip sensors touch, and what a closed grip does."""

import numpy as np
import pymunk
import pytest
from parkour_worlds import in_chipmunk, parkour_rules, parkour_world, swung, without_creepers

from tma_ray.embodiments import load_embodiment
from tma_ray.physics.base import HANGING_STEPS
from tma_ray.physics.compiled.engine import CompiledEngine
from tma_ray.physics.kernels import CEILING, NOTHING, graspable, world_of
from tma_ray.terrain import Terrain

CLIMBERS = ("climbing_chimpanzee", "climbing_chest_chimpanzee")
BODY = load_embodiment("climbing_chimpanzee")
REACH = 0.06


def brute_force(x: float, y: float, shapes: list[pymunk.Shape], ceiling: np.ndarray) -> int:
    """Return the first creeper within reach, or whether the ceiling is, by distances to all of them."""
    for index, shape in enumerate(shapes):
        if shape.point_query((x, y)).distance <= REACH:
            return index
    start, along = ceiling[:, :2], ceiling[:, 2:] - ceiling[:, :2]
    share = ((np.array([x, y]) - start) * along).sum(axis=1) / np.square(along).sum(axis=1)
    nearest = start + np.clip(share, 0, 1)[:, None] * along
    return CEILING if np.hypot(*(nearest - [x, y]).T).min() <= REACH else NOTHING


@pytest.mark.parametrize("swinging", [False, True])
def test_a_sensor_touches_what_is_within_its_reach(swinging: bool) -> None:
    rng = np.random.default_rng(1)
    terrain = parkour_world(creepers=(0.25, 1.5, 0.0), swinging=swinging)
    world = swung(terrain, rng) if swinging else world_of(terrain)
    _space, shapes = in_chipmunk(world)
    touched = []
    for _ in range(400):
        x = rng.uniform(0, 102)
        segment = world.ceiling[np.searchsorted(world.ceiling[:, 2], x)]
        share = (x - segment[0]) / (segment[2] - segment[0])
        y = (
            segment[1]
            + share * (segment[3] - segment[1])
            - rng.choice([rng.uniform(-0.1, 0.1), rng.uniform(0, 2)])
        )
        touched.append(graspable(x, y, REACH, world))
        assert touched[-1] == brute_force(x, y, shapes, world.ceiling)
    kinds = np.clip(touched, NOTHING, 0)
    assert all(np.count_nonzero(kinds == kind) > 20 for kind in (NOTHING, CEILING, 0))


def engine_on(terrain: Terrain, name: str = BODY.name) -> CompiledEngine:
    body = load_embodiment(name)
    engine = CompiledEngine(body, parkour_rules(body))
    engine.observation = engine.reset(terrain, 3.0)
    return engine


def act(engine: CompiledEngine, grips: tuple[float, float], steps: int = 1) -> np.ndarray:
    action = np.zeros(len(engine.arrays.motors) + 2)
    action[-2:] = grips
    for _ in range(steps):
        observation, *_ = engine.step(action)
    return observation


def grip_values(engine: CompiledEngine, observation: np.ndarray) -> list[float]:
    """Return what each sensor touches and whether it holds, as observed."""
    return observation[-24:-20].tolist()


@pytest.mark.parametrize("name", CLIMBERS)
def test_climbers_start_hanging_by_both_hands(name: str) -> None:
    terrain = without_creepers(parkour_world())
    engine = engine_on(terrain, name)
    assert engine.grips.tolist() == [[CEILING, CEILING]] * 2
    assert grip_values(engine, engine.observation) == [1.0] * 4
    assert engine.medium.tolist() == [0, 0]
    assert HANGING_STEPS == 6


@pytest.mark.parametrize("name", CLIMBERS)
@pytest.mark.parametrize("closed", [1.0, 0.01])
def test_closed_grips_hold_and_open_ones_let_go(name: str, closed: float) -> None:
    engine = engine_on(without_creepers(parkour_world()), name)
    places = []
    for _ in range(100):
        act(engine, (closed, closed))
        places.append(hands(engine).copy())
    assert np.ptp(places, axis=0).max() < 0.02
    assert act(engine, (0.0, closed)).tolist()[-24:-20] == [1.0, 0.0, 1.0, 1.0]
    act(engine, (0.0, -1.0), 20)
    assert np.all(engine.grips == NOTHING)
    assert engine.state[BODY.head, 4] < -3


def hands(engine: CompiledEngine) -> np.ndarray:
    """Return where the sensors are (2, 2)."""
    pose = engine.state[engine.arrays.grip_part]
    x, y = engine.arrays.grips[:, :2].T
    cosine, sine = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    return pose[:, :2] + np.column_stack([cosine * x - sine * y, sine * x + cosine * y])


def test_an_open_grip_closes_only_on_what_it_touches() -> None:
    engine = engine_on(without_creepers(parkour_world()))
    act(engine, (0.0, 0.0), 30)
    assert grip_values(engine, act(engine, (1.0, 1.0), 5)) == [0.0] * 4


def test_whoever_falls_past_creepers_can_catch_one() -> None:
    """Only the start's ceiling is level: the fall goes along creepers of 4 m."""
    for seed in range(20):
        engine = engine_on(parkour_world(creepers=(1.0, 4.0, 0.0), seed=seed))
        act(engine, (0.0, 0.0), 15)
        act(engine, (1.0, 1.0), 30)
        if np.any(engine.grips[:, 1] >= 0):
            assert abs(engine.state[BODY.head, 4]) < 6
            return
    pytest.fail("no fall came past a creeper: nothing was tested")


def test_holding_a_creeper_that_swings_moves_it() -> None:
    terrain = parkour_world(creepers=(1.0, 1.0, 0.0), swinging=True)
    engine = engine_on(terrain)
    held = engine.grips[:, 1]
    assert np.all(held >= 0)
    rest, world = world_of(terrain).poses, engine._world[0]
    act(engine, (1.0, 1.0), 50)
    moved = np.abs(world.poses - rest).max(axis=1)
    assert moved[held[0]] > 0.01
    assert np.all(moved[np.abs(terrain.creepers[:, 0] - terrain.spawn[0]) > 5] < 1e-6)
    centres = np.hypot(*(hands(engine) - world.poses[held, :2]).T)
    assert np.all(centres < 1.0), "the hands have gone with the creepers"
