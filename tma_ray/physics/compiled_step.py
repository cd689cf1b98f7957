"""A whole environment step in one compiled call."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import carray  # type: ignore[attr-defined]
from numpy.typing import NDArray

from tma_ray.jit import kernel
from tma_ray.physics import symbols
from tma_ray.physics.arrays import StepArrays
from tma_ray.physics.kernels import command_motors, judge, observe

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

FLOATS, INTEGERS = 5, 6
"""Single values at the start of a memory's vectors; `views` names them."""


class Memory(NamedTuple):
    """Everything that a step reads and writes but the terrain.

    Only two vectors, because numba takes longer to receive twenty arrays than Chipmunk to simulate a body.

    Attributes:
        floats: (FLOATS + 6 j + 2 r + 6 p,).
        integers: (INTEGERS + 1 + 3 p + 4 j + 2 h,).
    """

    floats: Floats
    integers: Integers


class Simulation(NamedTuple):
    """Views of a memory: what changes while p parts and h joints, j of them with motors, are simulated.

    Attributes:
        action: (j,).
        commands: (j, 2), as `command_motors` writes them.
        state: (p, 6).
        contacts: (p,).
        handles: pointers to the space, p bodies, j motors, h limits and h pivots (1 + p + j + 2 h,).
    """

    action: Floats
    commands: Floats
    state: Floats
    contacts: Integers
    handles: Integers


def new_memory(body: StepArrays, all_joints: int) -> Memory:
    """Returns the memory for a body, which is copied into it, with `all_joints` joints, passive ones too."""
    parts, joints, rays = len(body.critical), len(body.motors), len(body.rays)
    memory = Memory(
        np.zeros(FLOATS + 6 * joints + 2 * rays + 6 * parts),
        np.zeros(INTEGERS + 1 + 3 * parts + 4 * joints + 2 * all_joints, dtype=np.int64),
    )
    memory.integers[:4] = parts, joints, rays, body.head
    memory.floats[:2] = body.torque_cost, body.upright_weight
    copy, _ = views(memory.floats, memory.integers)
    for name in ("critical", "joint_parts", "contact_part", "motors", "rays"):
        getattr(copy, name)[:] = getattr(body, name)
    return memory


@kernel
def views(floats: Floats, integers: Integers) -> tuple[StepArrays, Simulation]:
    """Returns the contents of a memory by name."""
    parts, joints, rays = integers[0], integers[1], integers[2]
    motors, floats_left = floats[FLOATS : FLOATS + 3 * joints], floats[FLOATS + 3 * joints :]
    ends, floats_left = floats_left[: 2 * rays], floats_left[2 * rays :]
    action, floats_left = floats_left[:joints], floats_left[joints:]
    commands, state = floats_left[: 2 * joints], floats_left[2 * joints :]
    critical, left = integers[INTEGERS : INTEGERS + parts], integers[INTEGERS + parts :]
    joint_parts, left = left[: 2 * joints], left[2 * joints :]
    contact_part, left = left[:joints], left[joints:]
    contacts, handles = left[:parts], left[parts:]
    body = StepArrays(
        integers[3],
        critical,
        joint_parts.reshape(joints, 2),
        contact_part,
        motors.reshape(joints, 3),
        floats[0],
        floats[1],
        ends.reshape(rays, 2),
    )
    return body, Simulation(action, commands.reshape(joints, 2), state.reshape(parts, 6), contacts, handles)


@kernel
def advance(simulation: Simulation, substeps: int, duration: float, count_contact: int) -> None:
    """Lets `substeps` of `duration` s pass under `simulation.commands`, then reads state and contacts."""
    parts, joints = len(simulation.state), len(simulation.commands)
    for joint in range(joints):
        motor = simulation.handles[1 + parts + joint]
        # Chipmunk's rate is the speed of the first part relative to the second.
        symbols.motor_set_rate(motor, -simulation.commands[joint, 0])
        symbols.constraint_set_max_force(motor, simulation.commands[joint, 1])
    for _ in range(substeps):
        symbols.space_step(simulation.handles[0], duration)
    for part in range(parts):
        body, values = simulation.handles[1 + part], simulation.state[part]
        values[0], values[1] = symbols.body_position(body)
        values[2] = symbols.body_angle(body)
        values[3], values[4] = symbols.body_velocity(body)
        values[5] = symbols.body_angular_velocity(body)
        simulation.contacts[part] = 0
        symbols.body_each_arbiter(body, count_contact, simulation.contacts[part:].ctypes.data)


@kernel
def step(
    floats: Floats, integers: Integers, surface: Floats, observation: NDArray[np.float32]
) -> tuple[float, bool]:
    """Runs a step under the action in the memory: motors, simulation, observation and reward.

    Args:
        floats: of the memory.
        integers: of the memory.
        surface: of the terrain (m, 4).
        observation: written (o,).

    Returns:
        Reward, NaN if the action was not finite and nothing happened; end of the episode.
    """
    body, simulation = views(floats, integers)
    substeps, count_contact = integers[4], integers[5]
    duration, before, goal_x = floats[2], floats[3], floats[4]
    cost = command_motors(simulation.action, body, simulation.commands)
    if math.isnan(cost):
        return cost, False
    advance(simulation, substeps, duration, count_contact)
    state, contacts = simulation.state, simulation.contacts
    observe(state, contacts, body, surface, observation)
    reward, ended, floats[3] = judge(state, contacts, body, goal_x, cost, before)
    return reward, ended


@kernel
def step_worlds(
    addresses: Integers,
    actions: NDArray[np.float32],
    observations: NDArray[np.float32],
    rewards: Floats,
    ended: NDArray[np.bool_],
) -> None:
    """Runs a step of k worlds of one body.

    Args:
        addresses: of each memory's floats and integers and of the terrain's surface, with their lengths
            (k, 6).
        actions: (k, j).
        observations: written (k, o).
        rewards: written (k,); NaN as `step` has it.
        ended: written (k,).
    """
    for row in range(len(addresses)):
        floats_at, floats_size, integers_at, integers_size, surface_at, segments = addresses[row]
        floats = carray(symbols.as_pointer(floats_at), floats_size, np.float64)
        integers = carray(symbols.as_pointer(integers_at), integers_size, np.int64)
        surface = carray(symbols.as_pointer(surface_at), (segments, 4), np.float64)
        _, simulation = views(floats, integers)
        simulation.action[:] = actions[row]
        rewards[row], ended[row] = step(floats, integers, surface, observations[row])
