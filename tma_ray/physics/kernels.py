"""Motors, sensors, reward and termination, written once for every engine.

Small functions over arrays that run compiled or as plain Python, bit for bit the same.
A state is (p, 6): each part's origin x, y, angle, velocity x, y of its centre of mass, angular velocity
(m, rad, s). `contacts` (p, 2) counts the pieces of ground and of ceiling that each part touches.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tma_ray.jit import kernel
from tma_ray.physics.grips import NOTHING
from tma_ray.physics.lidars import look
from tma_ray.physics.rules import StepArrays
from tma_ray.physics.world import World

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

FORWARD_WEIGHT = 130 / 30
"""Reward per metre that the head moves forward."""

FALL_REWARD = -100.0
"""Reward of the step in which the body falls or leaves the track backwards."""

ANGULAR_VELOCITY_SCALE = 2 / 50
VELOCITY_X_SCALE = 0.3 * (600 / 30) / 50
VELOCITY_Y_SCALE = 0.3 * (400 / 30) / 50


@kernel
def command_motors(action: Floats, alive: bool, body: StepArrays, commands: Floats) -> float:
    """Writes each motor's target speed (rad/s) and largest torque (N m) to `commands` (j, 2).

    An action's sign is the direction, its size (at most 1) the share of the torque; 0 leaves the joint limp.

    Args:
        action: of motors, then of grip sensors (j + g,); all 0 afterwards if the body is dead.
        alive: whether the body has survived its medium.
        body: the body.
        commands: written.

    Returns:
        What the actions cost in reward; NaN if one is not finite.
    """
    effort = 0.0
    for index in range(len(action)):
        if not math.isfinite(action[index]):
            return math.nan
        if not alive:
            action[index] = 0.0
        value = action[index]
        share = min(abs(value), 1.0)
        effort += share
        if index < len(commands):
            direction = 1.0 if value > 0 else (-1.0 if value < 0 else 0.0)
            commands[index, 0] = direction * body.motors[index, 1]
            commands[index, 1] = share * body.motors[index, 0]
    return effort * body.torque_cost


@kernel
def survives(medium: Integers, body: StepArrays) -> bool:
    """Tells whether the body is alive after consecutive steps under water and outside it (2,)."""
    drowned = 0 <= body.survivable[0] < medium[0]
    dried = 0 <= body.survivable[1] < medium[1]
    return not (drowned or dried)


@kernel
def breathe(state: Floats, water_y: float, body: StepArrays, medium: Integers) -> None:
    """Counts a step in `medium` (2,): under water or outside it, where the head is. The dead do not count."""
    if survives(medium, body):
        submerged = state[body.head, 1] <= water_y
        medium[0] = medium[0] + 1 if submerged else 0
        medium[1] = 0 if submerged else medium[1] + 1


@kernel
def observe(
    state: Floats,
    contacts: Integers,
    medium: Integers,
    grips: Integers,
    body: StepArrays,
    world: World,
    observation: NDArray[np.float32],
) -> None:
    """Writes what the body senses, in the release's units and order.

    That is its head; whether the head is under water and the body was dead when it acted; joints and
    contacts; what each grip sensor touches and holds; lidars, and what they hit. Rules say whether the medium
    is observed.

    Args:
        state: (p, 6).
        contacts: (p, 2).
        medium: consecutive steps under water and outside it before this one (2,).
        grips: what each sensor touches and holds (g, 2).
        body: the body.
        world: the world.
        observation: (o,), written.
    """
    head = state[body.head]
    observation[0] = head[2]
    observation[1] = ANGULAR_VELOCITY_SCALE * head[5]
    observation[2] = VELOCITY_X_SCALE * head[3]
    observation[3] = VELOCITY_Y_SCALE * head[4]
    at = 4
    if body.observes_medium:
        observation[at] = 1.0 if head[1] <= world.water_y else 0.0
        observation[at + 1] = 0.0 if survives(medium, body) else 1.0
        at += 2
    for joint in range(len(body.joint_parts)):
        a, b = state[body.joint_parts[joint, 0]], state[body.joint_parts[joint, 1]]
        observation[at] = b[2] - a[2] + body.motors[joint, 2]
        observation[at + 1] = (b[5] - a[5]) / body.motors[joint, 1]
        at += 2
        if body.contact_part[joint] >= 0:
            touches = contacts[body.contact_part[joint]]
            observation[at] = 1.0 if touches[0] + touches[1] > 0 else 0.0
            at += 1
    for sensor in range(len(grips)):
        observation[at] = 1.0 if grips[sensor, 0] != NOTHING else 0.0
        observation[at + 1] = 1.0 if grips[sensor, 1] != NOTHING else 0.0
        at += 2
    _observe_lidars(head, body, world, observation[at:])


@kernel
def _observe_lidars(head: Floats, body: StepArrays, world: World, observation: NDArray[np.float32]) -> None:
    """Writes what the rays meet, and how far away, to the end of an observation."""
    rays = len(body.rays)
    for ray in range(rays):
        fraction, kind = look(head[0], head[1], body.rays[ray], world)
        observation[ray] = fraction
        if body.observes_medium:
            observation[rays + ray] = kind


@kernel
def shaping(state: Floats, body: StepArrays) -> float:
    """Returns the potential whose growth is the reward: progress of the head, less its tilt."""
    head = state[body.head]
    potential: float = FORWARD_WEIGHT * head[0] - body.upright_weight * abs(head[2])
    return potential


@kernel
def has_fallen(state: Floats, contacts: Integers, body: StepArrays) -> bool:
    """Tells whether a critical part touches what it must not or the head is behind the start of the track."""
    for part in range(len(contacts)):
        if body.critical[part]:
            if contacts[part, 0] > 0:
                return True
            if contacts[part, 1] > 0 and not body.may_touch_ceiling:
                return True
    behind: bool = state[body.head, 0] < 0
    return behind


@kernel
def judge(
    state: Floats, contacts: Integers, body: StepArrays, goal_x: float, cost: float, before: float
) -> tuple[float, bool, float]:
    """Judges a step.

    Args:
        state: (p, 6) after the step.
        contacts: (p, 2) after the step.
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
