"""Worlds of Parkour for tests and measurements of the physics."""

from collections.abc import Sequence
from functools import cache

import numpy as np
import pymunk

from tma_ray.embodiments import Embodiment
from tma_ray.physics import Rules
from tma_ray.physics.kernels import World, world_of
from tma_ray.terrain import Terrain
from tma_ray.terrain.parkour import CPPN, parkour

THETA = (-0.1, 0.9, 0.1)
CREEPERS = (0.25, 1.5, 1.0)
DELTA = 10.0
SHIPPED = CPPN.load()


def parkour_rules(body: Embodiment) -> Rules:
    """Return the rules of Parkour for a body, as in the environment."""
    return Rules("parkour", body.lidars, observes_medium=True)


def parkour_world(
    water: float = 0.0,
    creepers: tuple[float, float, float] = CREEPERS,
    *,
    theta: Sequence[float] = THETA,
    delta: float = DELTA,
    cppn: CPPN = SHIPPED,
    swinging: bool = False,
    seed: int = 0,
) -> Terrain:
    """Return a world with `creepers` of given width, mean height and spacing, in m."""
    task = np.array([*theta, water, *creepers, delta], dtype=np.float32)
    return parkour(task, np.random.default_rng(seed), cppn=cppn, swinging_creepers=swinging)


def without_creepers(terrain: Terrain) -> Terrain:
    return terrain._replace(creepers=np.empty((0, 4)), holders=np.empty(0, np.int64))


@cache
def dry() -> Terrain:
    """Return a world without creepers and water."""
    return without_creepers(parkour_world(0.0))


@cache
def deep() -> Terrain:
    """Return a world without creepers, full of water."""
    return without_creepers(parkour_world(1.0))


def swung(terrain: Terrain, rng: np.random.Generator) -> World:
    """Return the world of a terrain with randomly rotated and moved creepers."""
    world = world_of(terrain)
    angles = rng.uniform(-1.2, 1.2, len(world.poses))
    moved = world.poses[:, :2] + rng.uniform(-0.5, 0.5, (len(angles), 2))
    poses = np.column_stack([moved, np.cos(angles), np.sin(angles)])
    return world._replace(poses=poses, sway=max(world.sway, 3.0))


def in_chipmunk(world: World) -> tuple[pymunk.Space, list[pymunk.Poly]]:
    """Return the creepers of a world as shapes of Chipmunk, with their space."""
    space, shapes = pymunk.Space(), []
    for (left, low, right, high), (x, y, cosine, sine) in zip(world.creepers, world.poses, strict=True):
        body = pymunk.Body(body_type=pymunk.Body.STATIC)
        body.position, body.angle = (x, y), float(np.arctan2(sine, cosine))
        shapes.append(pymunk.Poly.create_box(body, (right - left, high - low)))
        space.add(body, shapes[-1])
    return space, shapes
