"""The elements of a world, as plain arrays."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

STEP = 14 / 30  # terrain step in m: the grid of the original release, and the unit of stump heights

GROUND_HEIGHT = 10 / 3
"""Height of the start's ground, in m."""

STARTPAD_STEPS = 20  # flat terrain steps before the first obstacle; bodies spawn over its middle


class Terrain(NamedTuple):
    """One world.

    Attributes:
        solids: corners of convex quadrilaterals (n, 4, 2), counter-clockwise, in m; the ground's first.
        friction: coefficient of all solids.
        surface: lidar segments of the ground (m, 4) as x0, y0, x1, y1, in m, solid on their right side.
            Both ends are sorted by x, so that the segments near an x are found by bisection.
        spawn: spawn point on the ground (2,), in m.
        goal_x: x that ends the episode once the head is past it, in m.
        ground_solids: number of solids that are ground; the others are ceiling, which can be grasped.
        ceiling: lidar segments of the ceiling (k, 4), sorted alike, solid on their left side; none under
            an open sky.
        creepers: rectangles that can be grasped and are otherwise passed through (c, 4) as left, bottom,
            right, top, in m, sorted by left, and from the ceiling downwards.
        holders: holder of each creeper (c,): FIXED if it does not move, CEILING, or the index of an
            earlier creeper, to whose bottom its top is then hinged.
        water_y: height of the water's surface, in m; -inf where it is dry.
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


FIXED, CEILING = -2, -1
"""Values of `Terrain.holders`."""
