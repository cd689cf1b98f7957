"""Terrain of a world as arrays, and constants of all terrains."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

TERRAIN_STEP = 14 / 30  # unit of stump heights, and the original release's grid size, in m
GROUND_HEIGHT = 10 / 3  # height of the ground at the start, in m
STARTPAD_STEPS = 20  # terrain steps of flat ground at the start; bodies spawn above its middle
FRICTION = 2.5  # friction coefficient of ground, stumps and ceiling
OVERHANG = 20.0  # length of ground and ceiling beyond both ends of the track, in m; longer than lidars reach
DEPTH = 10.0  # distance that solids extend below the lowest ground and above the highest ceiling, in m

FIXED, CEILING = -2, -1  # special values of `Terrain.holders`


class Terrain(NamedTuple):
    """Terrain of a world, with solids, segments seen by lidars, creepers and water.

    Attributes:
        solids: corners of convex quadrilaterals (n, 4, 2), counter-clockwise, in m, ground before ceiling.
        friction: coefficient of all solids.
        surface: lidar segments of the ground (m, 4) as x0, y0, x1, y1, in m, solid on their right side.
            Both ends are sorted by x, for searching by bisection.
        spawn: spawn point on the ground (2,), in m.
        goal_x: x of the goal, which ends the episode once the head is past it, in m.
        ground_solids: number of solids that are ground; the others are ceiling, which can be grasped.
        ceiling: lidar segments of the ceiling (k, 4), sorted by x, solid on their left side; empty under
            an open sky.
        creepers: rectangles without collisions that can be grasped (c, 4) as left, bottom, right, top, in
            m, sorted by left, and from the ceiling downwards.
        holders: holder of each creeper (c,): FIXED if it does not move, CEILING, or the index of an
            earlier creeper, to whose bottom its top is hinged.
        water_y: height of the water's surface, in m; -inf in a dry world.
    """

    solids: NDArray[np.float64]
    friction: float
    surface: NDArray[np.float64]
    spawn: NDArray[np.float64]
    goal_x: float
    ground_solids: int
    ceiling: NDArray[np.float64]
    creepers: NDArray[np.float64]
    holders: NDArray[np.int64]
    water_y: float
