"""Stump Tracks: flat ground with stumps of random height at regular gaps (paper, appendix B)."""

import numpy as np
from numpy.typing import NDArray

from tma_ray.support.jit import kernel
from tma_ray.tasks import Task
from tma_ray.terrain.base import GROUND_HEIGHT, STARTPAD_STEPS, STEP, Terrain

TRACK_LENGTH = 200 * STEP
"""x at which the last stump ends at the latest, in m."""

GOAL_X = 190 * STEP
"""x of the goal, in m."""

FIRST_STUMP = STARTPAD_STEPS * STEP
"""x of the first stump's left side, in m."""

STUMP_HEIGHT_STD = 0.1
"""Standard deviation of stump heights around the task's mean, in terrain steps."""

MINIMUM_STUMP_HEIGHT = 0.05
"""Height under which no stump is drawn, in terrain steps."""

STUMP_WIDTH = STEP
"""Width of every stump, in m."""

MINIMUM_SPACING = 0.01
"""Smallest gap between two stumps, in m."""

FRICTION = 2.5
"""Friction coefficient of ground and stumps."""

MARGIN = 20.0
"""How far the ground reaches past both ends of the track, in m: over any lidar and any fall."""

DEPTH = 10.0
"""How deep ground and stumps reach under the surface, in m: nothing is pushed out below."""

Floats = NDArray[np.float64]


def stump_tracks(task: Task, rng: np.random.Generator) -> Terrain:
    """Return the world of `task`.

    Args:
        task: mean stump height in terrain steps, and the gap between stumps in m. A negative mean counts
            as 0 (the original release keeps it, and so draws stumps of the minimum height only).
        rng: source of one height per stump.
    """
    mean_height, spacing = max(0.0, float(task[0])), max(MINIMUM_SPACING, float(task[1]))
    count = int((TRACK_LENGTH - FIRST_STUMP + spacing) / (STUMP_WIDTH + spacing))
    solids, surface = _lay_out(rng.normal(mean_height, STUMP_HEIGHT_STD, count), spacing)
    spawn = np.array([FIRST_STUMP / 2, GROUND_HEIGHT])
    nothing = np.empty((0, 4))
    return Terrain(
        solids,
        FRICTION,
        surface,
        spawn,
        GOAL_X,
        ground_solids=len(solids),
        ceiling=nothing,
        creepers=nothing,
        holders=np.empty(0, dtype=np.int64),
        water_y=-np.inf,
    )


@kernel
def _lay_out(heights: Floats, spacing: float) -> tuple[Floats, Floats]:
    """Return the solids and the surface of stumps with `heights` (n,) in terrain steps."""
    count = len(heights)
    solids, surface = np.empty((count + 1, 4, 2)), np.empty((4 * count + 1, 4))
    start, end = -MARGIN, TRACK_LENGTH + MARGIN
    _fill_box(solids[0], start, end, GROUND_HEIGHT)
    for index in range(count):
        left = FIRST_STUMP + index * (STUMP_WIDTH + spacing)
        right = left + STUMP_WIDTH
        top = GROUND_HEIGHT + max(MINIMUM_STUMP_HEIGHT, heights[index]) * STEP
        _fill_box(solids[index + 1], left, right, top)
        outline = (
            (start, GROUND_HEIGHT),
            (left, GROUND_HEIGHT),
            (left, top),
            (right, top),
            (right, GROUND_HEIGHT),
        )
        for side in range(4):
            segment = surface[4 * index + side]
            segment[0], segment[1] = outline[side]
            segment[2], segment[3] = outline[side + 1]
        start = right
    surface[4 * count] = np.array((start, GROUND_HEIGHT, end, GROUND_HEIGHT))
    return solids, surface


@kernel
def _fill_box(corners: Floats, left: float, right: float, top: float) -> None:
    """Write the corners (4, 2) of a solid that reaches DEPTH under the ground's surface."""
    bottom = GROUND_HEIGHT - DEPTH
    corners[0, 0], corners[0, 1] = left, bottom
    corners[1, 0], corners[1, 1] = right, bottom
    corners[2, 0], corners[2, 1] = right, top
    corners[3, 0], corners[3, 1] = left, top
