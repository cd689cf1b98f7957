"""Stump Tracks: flat ground with stumps of random height at regular gaps (paper, appendix B)."""

import numpy as np
from numpy.typing import NDArray

from tma_ray.support.jit import kernel
from tma_ray.tasks import Task
from tma_ray.terrain.terrain import (
    DEPTH,
    FRICTION,
    GROUND_HEIGHT,
    OVERHANG,
    STARTPAD_STEPS,
    TERRAIN_STEP,
    Terrain,
)

TRACK_LENGTH = 200 * TERRAIN_STEP  # x by which the last stump must end, in m
GOAL_X = 190 * TERRAIN_STEP  # x of the goal, in m
FIRST_STUMP = STARTPAD_STEPS * TERRAIN_STEP  # x where the first stump begins, in m

STUMP_HEIGHT_STD = 0.1  # standard deviation of heights around the task's mean, in terrain steps
MINIMUM_STUMP_HEIGHT = 0.05  # in terrain steps
STUMP_WIDTH = TERRAIN_STEP  # in m
MINIMUM_SPACING = 0.01  # smallest gap between two stumps, in m

Floats = NDArray[np.float64]


def stump_tracks(task: Task, rng: np.random.Generator) -> Terrain:
    """Return the terrain described by `task`.

    Args:
        task: mean stump height in terrain steps, and the gap between stumps in m. A negative mean counts
            as 0 (the original release keeps it, so that all stumps have the minimum height).
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
    """Return the solids and ground segments of a track with stumps of `heights` (n,) in terrain steps."""
    count = len(heights)
    solids, surface = np.empty((count + 1, 4, 2)), np.empty((4 * count + 1, 4))
    start, end = -OVERHANG, TRACK_LENGTH + OVERHANG
    _fill_box(solids[0], start, end, GROUND_HEIGHT)
    for index in range(count):
        left = FIRST_STUMP + index * (STUMP_WIDTH + spacing)
        right = left + STUMP_WIDTH
        top = GROUND_HEIGHT + max(MINIMUM_STUMP_HEIGHT, heights[index]) * TERRAIN_STEP
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
    """Write the corners (4, 2) of a rectangular solid that extends to DEPTH below the ground."""
    bottom = GROUND_HEIGHT - DEPTH
    corners[0, 0], corners[0, 1] = left, bottom
    corners[1, 0], corners[1, 1] = right, bottom
    corners[2, 0], corners[2, 1] = right, top
    corners[3, 0], corners[3, 1] = left, top
