"""A terrain as the kernels see it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tma_ray.terrain import FIXED, Terrain


class World(NamedTuple):
    """Terrain, water and creepers as sensors and grips meet them.

    Attributes:
        ground: lidar segments as in Terrain (m, 4).
        ceiling: likewise (k, 4).
        creepers: as in Terrain, where they hang at rest (c, 4).
        poses: each creeper's centre in m, cosine and sine of its angle (c, 4).
        movable: 1 for a creeper that swings, else 0 (c,).
        sway: how far a creeper may be from where it hangs at rest, in m.
        water_y: height of the water's surface, in m; -inf where it is dry.
        goal_x: the head past this x has arrived, in m.
    """

    ground: NDArray[np.float64]
    ceiling: NDArray[np.float64]
    creepers: NDArray[np.float64]
    poses: NDArray[np.float64]
    movable: NDArray[np.int64]
    sway: float
    water_y: float
    goal_x: float


def world_of(terrain: Terrain) -> World:
    """Returns `terrain` with its creepers at rest, its arrays contiguous: compiled code knows addresses."""
    poses = np.zeros((len(terrain.creepers), 4))
    poses[:, :2] = (terrain.creepers[:, :2] + terrain.creepers[:, 2:]) / 2
    poses[:, 2] = 1.0
    movable = terrain.holders != FIXED
    return World(
        np.ascontiguousarray(terrain.surface),
        np.ascontiguousarray(terrain.ceiling),
        np.ascontiguousarray(terrain.creepers),
        poses,
        movable.astype(np.int64),
        _longest_chain(terrain) if movable.any() else 0.0,
        terrain.water_y,
        terrain.goal_x,
    )


def _longest_chain(terrain: Terrain) -> float:
    """Returns the length of the longest chain of creepers in m, which is how far it can swing."""
    lengths = terrain.creepers[:, 3] - terrain.creepers[:, 1]
    for index, holder in enumerate(terrain.holders):
        if holder >= 0:
            lengths[index] += lengths[holder]
    return float(lengths.max())
