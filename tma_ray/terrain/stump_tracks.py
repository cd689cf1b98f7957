"""Stump Tracks: flat ground with stumps of random height at regular gaps (paper, appendix B)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tma_ray.tasks import Task
from tma_ray.terrain.terrain import GROUND_HEIGHT, STARTPAD_STEPS, STEP, Terrain

TRACK_LENGTH = 200 * STEP
"""x at which the last stump ends at the latest, in m."""

GOAL_X = 190 * STEP
"""x of the goal, in m."""

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


def stump_tracks(task: Task, rng: np.random.Generator) -> Terrain:
    """Returns the world of `task`.

    Args:
        task: mean stump height in terrain steps, and the gap between stumps in m. A negative mean counts
            as 0 (the original release keeps it, and so draws stumps of the minimum height only).
        rng: draws one height per stump.
    """
    mean_height, spacing = max(0.0, float(task[0])), max(MINIMUM_SPACING, float(task[1]))
    first = STARTPAD_STEPS * STEP
    count = int((TRACK_LENGTH - first + spacing) / (STUMP_WIDTH + spacing))
    left = first + np.arange(count, dtype=np.float64) * (STUMP_WIDTH + spacing)
    heights = np.maximum(MINIMUM_STUMP_HEIGHT, rng.normal(mean_height, STUMP_HEIGHT_STD, count)) * STEP
    right, top = left + STUMP_WIDTH, GROUND_HEIGHT + heights
    start, end = -MARGIN, TRACK_LENGTH + MARGIN
    ground = _boxes(np.array([start]), np.array([end]), np.array([GROUND_HEIGHT]))
    return Terrain(
        solids=np.concatenate([ground, _boxes(left, right, top)]),
        friction=FRICTION,
        surface=_surface(left, right, top, start, end),
        spawn=np.array([first / 2, GROUND_HEIGHT]),
        goal_x=GOAL_X,
    )


def _boxes(
    left: NDArray[np.float64], right: NDArray[np.float64], top: NDArray[np.float64]
) -> NDArray[np.float64]:
    bottom = np.full_like(top, GROUND_HEIGHT - DEPTH)
    corners = [(left, bottom), (right, bottom), (right, top), (left, top)]
    return np.stack([np.stack(corner, axis=-1) for corner in corners], axis=1)


def _surface(
    left: NDArray[np.float64], right: NDArray[np.float64], top: NDArray[np.float64], start: float, end: float
) -> NDArray[np.float64]:
    ground = np.full_like(top, GROUND_HEIGHT)
    outline = np.stack([left, ground, left, top, right, top, right, ground], axis=-1).reshape(-1, 2)
    points = np.concatenate([[[start, GROUND_HEIGHT]], outline, [[end, GROUND_HEIGHT]]])
    return np.ascontiguousarray(np.concatenate([points[:-1], points[1:]], axis=1))
