"""Buoyancy, drag, lift and push of water on a body's parts. Written once for every engine.

Source: paper, appendix B (physics of Parkour), with the original release's numbers and formulas. It lets
water end at the track's first and last point, ours does not; and its push knows a motor's torque with its
sign, of which Chipmunk tells the size only: here it has the sign of the motor's command.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tma_ray.jit import kernel
from tma_ray.physics.rules import StepArrays

Floats = NDArray[np.float64]

DENSITY = 1.0
"""Of water, in kg/m²."""

GRAVITY = 10.0
"""Weight of submerged water, in m/s²."""

DRAG, LARGEST_DRAG = 0.25, 2000.0
"""Coefficient, and bound in N."""

LIFT, LARGEST_LIFT = 0.25, 500.0
"""Coefficient, and upper bound in N."""

PUSH, LARGEST_PUSH = 0.05, 20.0
"""Coefficient, and bound of each component in N."""

TORQUE_SCALE = 60 / 50
"""The release takes a motor's torque for steps of 1/60 s instead of 1/50 s."""


@kernel
def water_forces(
    state: Floats, rotations: Floats, torques: Floats, body: StepArrays, water_y: float, forces: Floats
) -> bool:
    """Writes the forces of still water on each part, and tells whether there are any.

    Args:
        state: (p, 6).
        rotations: cosine and sine of each part's angle (p, 2).
        torques: of each motor in the last step, in N m (j,).
        body: the body.
        water_y: height of the surface, in m.
        forces: on the centre of mass, x and y in N, and torque about it in N m (p, 3), written.
    """
    wet = False
    for part in range(len(state)):
        forces[part] = 0.0
        if state[part, 1] - body.bounds[part, 0] < water_y:
            polygon = _submerged(part, state[part], rotations[part], body, water_y)
            if len(polygon) > 2:
                wet = True
                _press(part, polygon, state, rotations, torques, body, forces[part])
    return wet


@kernel
def _submerged(part: int, pose: Floats, rotation: Floats, body: StepArrays, water_y: float) -> Floats:
    """Returns the corners of what is under water of a part, in world axes (k, 2), counter-clockwise."""
    first, count = body.first_vertex[part], body.first_vertex[part + 1] - body.first_vertex[part]
    corners = np.empty((count, 2))
    for index in range(count):
        x, y = body.vertices[first + index, 0], body.vertices[first + index, 1]
        corners[index, 0] = pose[0] + rotation[0] * x - rotation[1] * y
        corners[index, 1] = pose[1] + rotation[1] * x + rotation[0] * y
    clipped, size = np.empty((count + 1, 2)), 0
    for index in range(count):
        here, there = corners[index], corners[(index + 1) % count]
        if here[1] <= water_y:
            clipped[size] = here
            size += 1
        if (here[1] <= water_y) != (there[1] <= water_y):
            share = (water_y - here[1]) / (there[1] - here[1])
            clipped[size, 0] = here[0] + share * (there[0] - here[0])
            clipped[size, 1] = water_y
            size += 1
    return clipped[:size]


@kernel
def _press(
    part: int,
    polygon: Floats,
    state: Floats,
    rotations: Floats,
    torques: Floats,
    body: StepArrays,
    force: Floats,
) -> None:
    """Adds all forces on the submerged `polygon` of a part to `force` (3,)."""
    rotation = rotations[part]
    across, up = body.bounds[part, 2], body.bounds[part, 3]
    centre_x = state[part, 0] + rotation[0] * across - rotation[1] * up
    centre_y = state[part, 1] + rotation[1] * across + rotation[0] * up
    x, area = _centroid(polygon)
    force[1] += DENSITY * area * GRAVITY
    force[2] += (x - centre_x) * DENSITY * area * GRAVITY
    for index in range(len(polygon)):
        start, end = polygon[index], polygon[(index + 1) % len(polygon)]
        edge_x, edge_y = end[0] - start[0], end[1] - start[1]
        length = math.sqrt(edge_x * edge_x + edge_y * edge_y)
        if length > 0:
            edge_x, edge_y = edge_x / length, edge_y / length
            lever_x, lever_y = (start[0] + end[0]) / 2 - centre_x, (start[1] + end[1]) / 2 - centre_y
            _resist((edge_x, edge_y, length), (lever_x, lever_y), state[part], force)
            for joint in range(len(body.hinges)):
                if body.joint_parts[joint, 1] == part:
                    _push(joint, (edge_x, edge_y, length), state, rotation, torques[joint], body, force)


@kernel
def _centroid(polygon: Floats) -> tuple[float, float]:
    """Returns the x of a polygon's centroid in m, and its area in m²."""
    base, area, moment = polygon[0], 0.0, 0.0
    for index in range(1, len(polygon) - 1):
        ax, ay = polygon[index, 0] - base[0], polygon[index, 1] - base[1]
        bx, by = polygon[index + 1, 0] - base[0], polygon[index + 1, 1] - base[1]
        wedge = (ax * by - ay * bx) / 2
        area += wedge
        moment += wedge * (ax + bx) / 3
    return (base[0] + moment / area if area > 0 else base[0]), area


@kernel
def _resist(
    edge: tuple[float, float, float], lever: tuple[float, float], motion: Floats, force: Floats
) -> None:
    """Adds drag and lift on an edge that moves outwards (paper: drag against the motion, lift across it).

    Args:
        edge: its direction and length.
        lever: its middle relative to the centre of mass.
        motion: state of the part (6,).
        force: (3,), added to.
    """
    velocity_x, velocity_y = motion[3] - motion[5] * lever[1], motion[4] + motion[5] * lever[0]
    speed = math.sqrt(velocity_x * velocity_x + velocity_y * velocity_y)
    if speed == 0:
        return
    x, y = velocity_x / speed, velocity_y / speed
    outwards = edge[1] * x - edge[0] * y
    if outwards < 0:
        return
    pressure = outwards * edge[2] * DENSITY * speed * speed
    drag = min(DRAG * pressure, LARGEST_DRAG)
    lift = min(LIFT * pressure * (edge[0] * x + edge[1] * y), LARGEST_LIFT)
    _add(-drag * x - lift * y, -drag * y + lift * x, lever[0], lever[1], force)


@kernel
def _push(
    joint: int,
    edge: tuple[float, float, float],
    state: Floats,
    rotation: Floats,
    torque: float,
    body: StepArrays,
    force: Floats,
) -> None:
    """Adds what pushes a part forwards whose joint turns it, if the joint is not at a limit."""
    first, second = body.joint_parts[joint]
    hinge, motion = body.hinges[joint], state[second]
    if not hinge[2] < motion[2] - state[first, 2] < hinge[3]:
        return
    across, up = body.bounds[second, 2] - hinge[0], body.bounds[second, 3] - hinge[1]
    lever_x, lever_y = rotation[0] * across - rotation[1] * up, rotation[1] * across + rotation[0] * up
    turn = TORQUE_SCALE * torque
    pull_x, pull_y = -turn * lever_y, turn * lever_x
    outwards = edge[1] * pull_x - edge[0] * pull_y
    if outwards <= 0:
        return
    momentum = turn + body.bounds[second, 1] * motion[5]
    size = outwards * PUSH * edge[2] * DENSITY * momentum * momentum
    x = min(max(-size * pull_x, -LARGEST_PUSH), LARGEST_PUSH)
    y = min(max(-size * pull_y, -LARGEST_PUSH), LARGEST_PUSH)
    _add(x, y, -lever_x, -lever_y, force)


@kernel
def _add(x: float, y: float, lever_x: float, lever_y: float, force: Floats) -> None:
    """Adds the force (x, y) that acts at a lever from the centre of mass."""
    force[0] += x
    force[1] += y
    force[2] += lever_x * y - lever_y * x
