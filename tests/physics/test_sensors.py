"""What lidars meet, against Chipmunk's own queries; what grip sensors touch, and what a closed grip does."""

import numpy as np
import pymunk
import pytest
from parkour_worlds import in_chipmunk, parkour_rules, parkour_world, swung, without_creepers

from tma_ray.embodiments import LidarLayout, load_embodiment
from tma_ray.physics import LIDAR_RANGE
from tma_ray.physics.base import HANGING_STEPS
from tma_ray.physics.compiled.engine import CompiledEngine
from tma_ray.physics.kernels import (
    CEILING,
    CREEPER,
    NOTHING,
    SOLID,
    WATER,
    World,
    cast_ray,
    graspable,
    world_of,
)
from tma_ray.physics.rules import lidar_angles
from tma_ray.terrain import Terrain

Shapes = list[tuple[float, pymunk.Poly]]


def shapes_of(world: World, terrain: Terrain) -> tuple[pymunk.Space, Shapes]:
    """Return what a ray can hit and what it is then told, and the Chipmunk space that keeps the shapes."""
    space, creepers = in_chipmunk(world)
    solids = [pymunk.Poly(space.static_body, corners) for corners in terrain.solids.tolist()]
    top = max(world.water_y, -400.0)
    deep = [(-500, -500), (500, -500), (500, top), (-500, top)]
    water = pymunk.Poly(space.static_body, deep)
    space.add(*solids, water)
    kinds = [SOLID] * len(solids) + [CREEPER] * len(creepers) + [WATER]
    return space, list(zip(kinds, [*solids, *creepers, water], strict=True))


SLOW = [pytest.param(*case, marks=pytest.mark.slow) for case in ((-np.inf, False), (4.0, True))]


@pytest.mark.parametrize(("depth", "swinging"), [(2.0, False), (0.5, True), *SLOW])
def test_a_ray_meets_what_is_nearest(depth: float, swinging: bool) -> None:
    rng = np.random.default_rng(2)
    terrain = parkour_world(creepers=(0.4, 2.0, 1.0), swinging=swinging)
    terrain = terrain._replace(water_y=np.median(terrain.surface[:, 1]) + depth)
    world = swung(terrain, rng) if swinging else world_of(terrain)
    (_space, shapes), kinds = shapes_of(world, terrain), []
    surface = (world.water_y - 5, world.water_y + 5)
    everywhere = (world.ground[:, 1].min(), world.ceiling[:, 1].max())
    while len(kinds) < 250:
        heights = surface if depth > 0 and len(kinds) % 2 else everywhere
        x, y = start = rng.uniform(0, 100), rng.uniform(*heights)
        angle = rng.uniform(-np.pi, np.pi)
        ray = LIDAR_RANGE * np.array([np.sin(angle), -np.cos(angle)])
        around = [shape.point_query(start).distance for kind, shape in shapes if kind == SOLID]
        if min(around) <= 0:
            continue
        hits = [(1.0, SOLID)]
        for kind, shape in shapes:
            hit = shape.segment_query(start, (x + ray[0], y + ray[1]))
            if hit is not None and shape.point_query(start).distance > 0:
                hits.append((hit.alpha, kind))
        expected = min(hits)
        share, kind = cast_ray(x, y, ray, world)
        assert share == pytest.approx(expected[0], abs=1e-9)
        assert kind == expected[1]
        kinds.append(kind if share < 1 else None)
    wanted = {SOLID, CREEPER, None} | ({WATER} if depth > 0 else set())
    assert {kind for kind in wanted if kinds.count(kind) > 10} == wanted


def test_a_ray_does_not_see_what_it_starts_in() -> None:
    world = world_of(parkour_world(0.9, (1.0, 3.0, 2.0)))
    left, low, right, _ = world.creepers[3]
    inside = (left + right) / 2, low + 1.0
    assert cast_ray(*inside, np.array([0.0, -0.5]), world) == (1.0, SOLID)
    assert cast_ray(left - 0.2, low + 1.0, np.array([0.4, 0.0]), world) == (pytest.approx(0.5), CREEPER)
    assert cast_ray(left - 0.2, low + 1.0, np.array([-0.1, 0.0]), world) == (1.0, SOLID)
    under = world.water_y - 1.0
    assert cast_ray(inside[0], under, np.array([0.0, 1.5]), world)[1] != WATER


def test_a_ray_from_above_sees_water_and_what_is_over_it() -> None:
    world = world_of(parkour_world(0.85))
    x, ground = 4.7, 10 / 3
    assert world.water_y > ground
    ray = np.array([0.0, -(world.water_y - ground + 1.0)])
    share, kind = cast_ray(x, world.water_y + 0.5, ray, world)
    assert (share, kind) == (pytest.approx(-0.5 / ray[1]), WATER)
    dry = world._replace(water_y=ground - 0.5)
    share, kind = cast_ray(x, ground + 0.5, np.array([0.0, -2.0]), dry)
    assert (share, kind) == (pytest.approx(0.25), SOLID)


@pytest.mark.parametrize(
    ("layout", "first", "last"),
    [
        (LidarLayout.DOWN, 0.0, 1.5 * 9 / 10),
        (LidarLayout.UP, 1.5, 1.5 + 2.3 * 9 / 10),
        (LidarLayout.FULL, 0.0, np.pi * 9 / 10),
    ],
)
def test_layouts_are_the_releases(layout: LidarLayout, first: float, last: float) -> None:
    np.testing.assert_allclose(lidar_angles(layout), np.linspace(first, last, 10), atol=1e-12)


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
        below = rng.choice([rng.uniform(-0.1, 0.1), rng.uniform(0, 2)])
        y = segment[1] + share * (segment[3] - segment[1]) - below
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
