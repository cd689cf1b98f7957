"""Contacts of grip sensors. Written once for every engine."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tma_ray.jit import kernel
from tma_ray.physics.lidars import creepers_between, first_segment
from tma_ray.physics.rules import StepArrays
from tma_ray.physics.world import World

Floats = NDArray[np.float64]

SKIN = 0.01
"""A sensor reaches this far beyond its radius, in m: the margin of the original release's polygons."""

NOTHING, CEILING = -2, -1
"""What a sensor touches or holds, if not a creeper, whose index says which."""


@kernel
def feel(
    state: Floats,
    rotations: Floats,
    body: StepArrays,
    world: World,
    points: Floats,
    grips: NDArray[np.int64],
) -> None:
    """Finds what each sensor touches, a creeper before the ceiling.

    Args:
        state: (p, 6).
        rotations: cosine and sine of each part's angle (p, 2).
        body: the body with g sensors.
        world: the world.
        points: where the sensors are (g, 2), in m, written.
        grips: what they touch, written, and hold (g, 2).
    """
    for sensor in range(len(body.grips)):
        part = body.grip_part[sensor]
        x, y, radius = body.grips[sensor]
        cosine, sine = rotations[part]
        points[sensor, 0] = state[part, 0] + cosine * x - sine * y
        points[sensor, 1] = state[part, 1] + sine * x + cosine * y
        grips[sensor, 0] = graspable(points[sensor, 0], points[sensor, 1], radius + SKIN, world)


@kernel
def graspable(x: float, y: float, reach: float, world: World) -> int:
    """Returns what is within `reach` m of a point: the index of a creeper, CEILING or NOTHING."""
    first, last = creepers_between(x - reach, x + reach, world)
    for index in range(first, last):
        if _near_box(x, y, reach, world.creepers[index], world.poses[index]):
            return index
    index = first_segment(world.ceiling, x - reach)
    while index < len(world.ceiling) and world.ceiling[index, 0] <= x + reach:
        if _near_segment(x, y, reach, world.ceiling[index]):
            return CEILING
        index += 1
    return NOTHING


@kernel
def _near_box(x: float, y: float, reach: float, rectangle: Floats, pose: Floats) -> bool:
    along, across = x - pose[0], y - pose[1]
    side = abs(pose[2] * along + pose[3] * across) - (rectangle[2] - rectangle[0]) / 2
    end = abs(pose[2] * across - pose[3] * along) - (rectangle[3] - rectangle[1]) / 2
    side, end = max(side, 0.0), max(end, 0.0)
    near: bool = side * side + end * end <= reach * reach
    return near


@kernel
def _near_segment(x: float, y: float, reach: float, segment: Floats) -> bool:
    along_x, along_y = segment[2] - segment[0], segment[3] - segment[1]
    from_x, from_y = x - segment[0], y - segment[1]
    share = (from_x * along_x + from_y * along_y) / (along_x * along_x + along_y * along_y)
    share = min(max(share, 0.0), 1.0)
    off_x, off_y = from_x - share * along_x, from_y - share * along_y
    near: bool = math.sqrt(off_x * off_x + off_y * off_y) <= reach
    return near


@kernel
def holder_anchor(point: Floats, held: int, world: World) -> tuple[float, float]:
    """Returns `point` in the frame of what holds it: that of a creeper that swings, else the world's."""
    if held < 0 or world.movable[held] == 0:
        return point[0], point[1]
    pose = world.poses[held]
    along, across = point[0] - pose[0], point[1] - pose[1]
    return pose[2] * along + pose[3] * across, pose[2] * across - pose[3] * along
