"""What rays meet in Parkour, against Chipmunk's own queries."""

import numpy as np
import pymunk
import pytest
from parkour_worlds import in_chipmunk, parkour_world, swung

from tma_ray.embodiments import LidarLayout
from tma_ray.physics import LIDAR_RANGE
from tma_ray.physics.kernels import CREEPER, SOLID, WATER, World, look, world_of
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
        share, kind = look(x, y, ray, world)
        assert share == pytest.approx(expected[0], abs=1e-9)
        assert kind == expected[1]
        kinds.append(kind if share < 1 else None)
    wanted = {SOLID, CREEPER, None} | ({WATER} if depth > 0 else set())
    assert {kind for kind in wanted if kinds.count(kind) > 10} == wanted


def test_a_ray_does_not_see_what_it_starts_in() -> None:
    world = world_of(parkour_world(0.9, (1.0, 3.0, 2.0)))
    left, low, right, _ = world.creepers[3]
    inside = (left + right) / 2, low + 1.0
    assert look(*inside, np.array([0.0, -0.5]), world) == (1.0, SOLID)
    assert look(left - 0.2, low + 1.0, np.array([0.4, 0.0]), world) == (pytest.approx(0.5), CREEPER)
    assert look(left - 0.2, low + 1.0, np.array([-0.1, 0.0]), world) == (1.0, SOLID)
    under = world.water_y - 1.0
    assert look(inside[0], under, np.array([0.0, 1.5]), world)[1] != WATER


def test_a_ray_from_above_sees_water_and_what_is_over_it() -> None:
    world = world_of(parkour_world(0.85))
    x, ground = 4.7, 10 / 3
    assert world.water_y > ground
    ray = np.array([0.0, -(world.water_y - ground + 1.0)])
    share, kind = look(x, world.water_y + 0.5, ray, world)
    assert (share, kind) == (pytest.approx(-0.5 / ray[1]), WATER)
    dry = world._replace(water_y=ground - 0.5)
    share, kind = look(x, ground + 0.5, np.array([0.0, -2.0]), dry)
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
