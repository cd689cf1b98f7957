"""Creepers that swing: rigid segments that hang from each other, and that nothing collides with."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pymunk
from numpy.typing import NDArray

from tma_ray.physics.engine import SolverSettings
from tma_ray.terrain import FIXED, Terrain

DENSITY = 5.0
"""In kg/m² (the original release's, like the next)."""

LARGEST_ANGLE = 0.4 * np.pi
"""How far a segment may turn from what it hangs from, in rad."""


class Chains(NamedTuple):
    """Creepers as an engine builds them, none if none of them swings; the values of fixed ones mean nothing.

    Attributes:
        holders: as in Terrain (c,).
        mass: in kg (c,).
        inertia: about the centre, in kg m² (c,).
        centre: at rest (c, 2), in m.
        anchors: of the hinge, in the frame of the holder and in the creeper's own (c, 2, 2), in m.
    """

    holders: NDArray[np.int64]
    mass: NDArray[np.float64]
    inertia: NDArray[np.float64]
    centre: NDArray[np.float64]
    anchors: NDArray[np.float64]


def chains(terrain: Terrain) -> Chains:
    """Returns the creepers of `terrain` as an engine builds them."""
    if not (terrain.holders != FIXED).any():
        return _NO_CHAINS
    low, high = terrain.creepers[:, :2], terrain.creepers[:, 2:]
    sizes, centre = high - low, (low + high) / 2
    mass = DENSITY * sizes.prod(axis=1)
    anchors = np.zeros((len(centre), 2, 2))
    anchors[:, 0] = np.stack([centre[:, 0], high[:, 1]], axis=1)
    held = np.flatnonzero(terrain.holders >= 0)
    anchors[held, 0, 0] = 0.0
    anchors[held, 0, 1] = -sizes[terrain.holders[held], 1] / 2
    anchors[:, 1, 1] = sizes[:, 1] / 2
    inertia = mass * np.square(sizes).sum(axis=1) / 12
    return Chains(terrain.holders, mass, inertia, centre, anchors)


_NO_CHAINS = Chains(np.empty(0, np.int64), *(np.empty((0, *rest)) for rest in ((), (), (2,), (2, 2))))


def add_creepers(space: pymunk.Space, creepers: Chains, settings: SolverSettings) -> dict[int, pymunk.Body]:
    """Adds the creepers that swing to `space` and returns their bodies by index."""
    bodies: dict[int, pymunk.Body] = {}
    for index in np.flatnonzero(creepers.holders != FIXED).tolist():
        body = pymunk.Body(creepers.mass[index], creepers.inertia[index])
        body.position = tuple(creepers.centre[index].tolist())
        bodies[index] = body
        holder = bodies.get(int(creepers.holders[index]), space.static_body)
        limit = pymunk.RotaryLimitJoint(holder, body, -LARGEST_ANGLE, LARGEST_ANGLE)
        limit.max_bias = settings.limit_correction_speed
        pivot = pymunk.PivotJoint(holder, body, *map(tuple, creepers.anchors[index].tolist()))
        limit.error_bias = pivot.error_bias = settings.joint_error_bias
        space.add(body, limit, pivot)
    return bodies
