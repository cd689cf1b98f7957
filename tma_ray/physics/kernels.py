"""Motors, sensors, reward and termination, written once for every engine.

Small functions over arrays that run compiled or as plain Python, bit for bit the same.
A state is (p, 6): each part's origin x, y, angle, velocity x, y of its centre of mass, angular velocity
(m, rad, s). `contacts` (p,) counts the things that each part touches.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tma_ray.jit import kernel
from tma_ray.physics.arrays import StepArrays

Floats = NDArray[np.float64]

FORWARD_WEIGHT = 130 / 30
"""Reward per metre that the head moves forward."""

FALL_REWARD = -100.0
"""Reward of the step in which the body falls or leaves the track backwards."""

ANGULAR_VELOCITY_SCALE = 2 / 50
VELOCITY_X_SCALE = 0.3 * (600 / 30) / 50
VELOCITY_Y_SCALE = 0.3 * (400 / 30) / 50


@kernel
def command_motors(action: Floats, body: StepArrays, commands: Floats) -> float:
    """Writes each motor's target speed (rad/s) and largest torque (N m) to `commands` (j, 2).

    An action's sign is the direction, its size (at most 1) the share of the torque; 0 leaves the joint limp.

    Returns:
        What the torques cost in reward; NaN if an action is not finite.
    """
    effort = 0.0
    for index in range(len(action)):
        value = action[index]
        if not math.isfinite(value):
            return math.nan
        share = min(abs(value), 1.0)
        direction = 1.0 if value > 0 else (-1.0 if value < 0 else 0.0)
        commands[index, 0] = direction * body.motors[index, 1]
        commands[index, 1] = share * body.motors[index, 0]
        effort += share
    return effort * body.torque_cost


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
def hit_fraction(x: float, y: float, ray: Floats, surface: Floats) -> float:
    """Returns the share of a ray's length at which it first enters a solid, 1 if it meets none.

    Args:
        x: start of the ray, in m.
        y: start of the ray, in m.
        ray: its end relative to the start (2,), in m.
        surface: segments (m, 4), solid on their right; a ray that starts inside a solid does not see it.
    """
    nearest = 1.0
    reach = max(x, x + ray[0])
    index = first_segment(surface, min(x, x + ray[0]))
    while index < len(surface) and surface[index, 0] <= reach:
        start_x, start_y = surface[index, 0] - x, surface[index, 1] - y
        along_x, along_y = surface[index, 2] - surface[index, 0], surface[index, 3] - surface[index, 1]
        inwards = ray[1] * along_x - ray[0] * along_y
        if inwards < 0:
            along_ray = (start_y * along_x - start_x * along_y) / inwards
            along_segment = (start_y * ray[0] - start_x * ray[1]) / inwards
            if 0 <= along_ray < nearest and 0 <= along_segment <= 1:
                nearest = along_ray
        index += 1
    return nearest


@kernel
def observe(
    state: Floats,
    contacts: NDArray[np.int64],
    body: StepArrays,
    surface: Floats,
    observation: NDArray[np.float32],
) -> None:
    """Writes head, joints, contacts and lidars to `observation` (o,), in the release's units and order."""
    head = state[body.head]
    observation[0] = head[2]
    observation[1] = ANGULAR_VELOCITY_SCALE * head[5]
    observation[2] = VELOCITY_X_SCALE * head[3]
    observation[3] = VELOCITY_Y_SCALE * head[4]
    at = 4
    for joint in range(len(body.joint_parts)):
        a, b = state[body.joint_parts[joint, 0]], state[body.joint_parts[joint, 1]]
        observation[at] = b[2] - a[2] + body.motors[joint, 2]
        observation[at + 1] = (b[5] - a[5]) / body.motors[joint, 1]
        at += 2
        if body.contact_part[joint] >= 0:
            observation[at] = 1.0 if contacts[body.contact_part[joint]] > 0 else 0.0
            at += 1
    for ray in range(len(body.rays)):
        observation[at + ray] = hit_fraction(head[0], head[1], body.rays[ray], surface)


@kernel
def shaping(state: Floats, body: StepArrays) -> float:
    """Returns the potential whose growth is the reward: progress of the head, less its tilt."""
    head = state[body.head]
    potential: float = FORWARD_WEIGHT * head[0] - body.upright_weight * abs(head[2])
    return potential


@kernel
def has_fallen(state: Floats, contacts: NDArray[np.int64], body: StepArrays) -> bool:
    """Tells whether a critical part touches anything or the head is behind the start of the track."""
    for part in range(len(contacts)):
        if body.critical[part] and contacts[part] > 0:
            return True
    behind: bool = state[body.head, 0] < 0
    return behind


@kernel
def judge(
    state: Floats, contacts: NDArray[np.int64], body: StepArrays, goal_x: float, cost: float, before: float
) -> tuple[float, bool, float]:
    """Judges a step.

    Args:
        state: (p, 6) after the step.
        contacts: (p,) after the step.
        body: the body.
        goal_x: the head past this x has arrived, which ends the episode without a bonus.
        cost: what the torques cost.
        before: shaping before the step.

    Returns:
        Reward (growth of the shaping less the cost; a fall replaces it), end of the episode, shaping.
    """
    after = shaping(state, body)
    if has_fallen(state, contacts, body):
        return FALL_REWARD, True, after
    return after - before - cost, state[body.head, 0] > goal_x, after
