"""What a world is made of, as plain arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

STEP = 14 / 30
"""Terrain step in m: the grid of the original release, and the unit of stump heights."""

GROUND_HEIGHT = 10 / 3
"""Height of the start's ground, in m."""

STARTPAD_STEPS = 20
"""Flat terrain steps before the first obstacle; bodies spawn over its middle."""


class Terrain(NamedTuple):
    """One world.

    Attributes:
        solids: corners of convex quadrilaterals (n, 4, 2), counter-clockwise, in m.
        friction: coefficient of all solids.
        surface: lidar segments (m, 4) as x0, y0, x1, y1, in m, solid on their right side. Both ends
            are sorted by x, so that the segments near an x are found by bisection.
        spawn: spawn point on the ground (2,), in m.
        goal_x: the head past this x ends the episode, in m.
    """

    solids: NDArray[np.float64]
    friction: float
    surface: NDArray[np.float64]
    spawn: NDArray[np.float64]
    goal_x: float
