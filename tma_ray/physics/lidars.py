"""Ray casting for lidars: ground, ceiling, creepers or water. Written once for every engine."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tma_ray.jit import kernel
from tma_ray.physics.world import World

Floats = NDArray[np.float64]

GROUND, CEILING = 1.0, -1.0
"""Sides of a surface's segments: the ground is solid on their right, the ceiling on their left."""

SOLID, CREEPER, WATER = 0.0, 1.0, -1.0
"""What a lidar reports to have hit; SOLID also if it hit nothing."""


@kernel
def look(x: float, y: float, ray: Floats, world: World) -> tuple[float, float]:
    """Returns the share of a ray's length at which it first meets something (1: nothing), and what.

    What the ray starts in, it does not see.

    Args:
        x: start of the ray, in m.
        y: start of the ray, in m.
        ray: its end relative to the start (2,), in m.
        world: what it may meet.
    """
    nearest = hit_fraction(x, y, ray, world.ground, GROUND)
    if len(world.ceiling) > 0:
        nearest = min(nearest, hit_fraction(x, y, ray, world.ceiling, CEILING))
    kind = SOLID
    if len(world.creepers) > 0:
        fraction = _creeper_fraction(x, y, ray, world)
        if fraction < nearest:
            nearest, kind = fraction, CREEPER
    if y > world.water_y and y + ray[1] < world.water_y:
        fraction = (world.water_y - y) / ray[1]
        if fraction < nearest:
            nearest, kind = fraction, WATER
    return nearest, kind


@kernel
def first_segment(surface: Floats, x: float) -> int:
    """Returns the index of the first segment (of m, sorted by x) that does not end before `x`."""
    low, high = 0, len(surface)
    while low < high:
        middle = (low + high) // 2
        if surface[middle, 2] < x:
            low = middle + 1
        else:
            high = middle
    return low


@kernel
def hit_fraction(x: float, y: float, ray: Floats, surface: Floats, side: float) -> float:
    """Returns the share of a ray's length at which it first enters a solid, 1 if it meets none.

    Args:
        x: start of the ray, in m.
        y: start of the ray, in m.
        ray: its end relative to the start (2,), in m.
        surface: segments (m, 4); a ray that starts inside a solid does not see it.
        side: GROUND or CEILING.
    """
    nearest = 1.0
    reach = max(x, x + ray[0])
    index = first_segment(surface, min(x, x + ray[0]))
    while index < len(surface) and surface[index, 0] <= reach:
        start_x, start_y = surface[index, 0] - x, surface[index, 1] - y
        along_x, along_y = surface[index, 2] - surface[index, 0], surface[index, 3] - surface[index, 1]
        inwards = ray[1] * along_x - ray[0] * along_y
        if side * inwards < 0:
            along_ray = (start_y * along_x - start_x * along_y) / inwards
            along_segment = (start_y * ray[0] - start_x * ray[1]) / inwards
            if 0 <= along_ray < nearest and 0 <= along_segment <= 1:
                nearest = along_ray
        index += 1
    return nearest


@kernel
def creepers_between(left: float, right: float, world: World) -> tuple[int, int]:
    """Returns the range of indices of the creepers that may lie between two x (m), and some more."""
    first = first_segment(world.creepers, left - world.sway)
    last = first
    while last < len(world.creepers) and world.creepers[last, 0] <= right + world.sway:
        last += 1
    return first, last


@kernel
def _creeper_fraction(x: float, y: float, ray: Floats, world: World) -> float:
    """Returns the share of a ray's length at which it first enters a creeper, 1 if it meets none."""
    nearest = 1.0
    first, last = creepers_between(min(x, x + ray[0]), max(x, x + ray[0]), world)
    for index in range(first, last):
        nearest = min(nearest, _box_fraction(x, y, ray, world.creepers[index], world.poses[index]))
    return nearest


@kernel
def _box_fraction(x: float, y: float, ray: Floats, rectangle: Floats, pose: Floats) -> float:
    """Returns the share of a ray's length at which it enters a turned rectangle, 1 if it does not.

    Clips the ray by the rectangle's two pairs of sides, in axes of the rectangle.
    """
    cosine, sine = pose[2], pose[3]
    along, across = x - pose[0], y - pose[1]
    enter, leave = 0.0, 1.0
    outside = False
    for axis in range(2):
        half = (rectangle[axis + 2] - rectangle[axis]) / 2
        if axis == 0:
            start, step = cosine * along + sine * across, cosine * ray[0] + sine * ray[1]
        else:
            start, step = cosine * across - sine * along, cosine * ray[1] - sine * ray[0]
        outside = outside or abs(start) > half
        if step == 0.0:
            if abs(start) > half:
                return 1.0
        else:
            near, far = (-half - start) / step, (half - start) / step
            enter, leave = max(enter, min(near, far)), min(leave, max(near, far))
    return enter if outside and enter <= leave else 1.0
