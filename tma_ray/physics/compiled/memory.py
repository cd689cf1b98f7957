"""The memory of a compiled step: two vectors, and views of them by name."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import carray  # type: ignore[attr-defined]
from numpy.typing import NDArray

import tma_ray.physics.compiled.symbols as cp
from tma_ray.jit import kernel
from tma_ray.physics.engine import TIME_STEP, SolverSettings, motor_substeps
from tma_ray.physics.grips import NOTHING
from tma_ray.physics.rules import StepArrays
from tma_ray.physics.world import World

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

FLOATS, INTEGERS = 8, 21
"""Single values at the start of a memory's vectors; `body_of`, `world_in` and `simulation_in` name them."""

DURATION, ERROR_BIAS, BEFORE, GOAL_X, WATER_Y, SWAY = 2, 3, 4, 5, 6, 7
"""Places among the floats, after the cost of torques and the weight of being upright."""

SUBSTEPS, MOTOR_SUBSTEPS, COUNT_CONTACT, TERRAIN = 9, 10, 11, 12
"""Places among the integers, after the sizes; at TERRAIN begin sizes and addresses of the world's arrays."""


class Memory(NamedTuple):
    """Everything that a step reads and writes, and the addresses of the world's arrays.

    Only two vectors, because numba takes longer to receive twenty arrays than Chipmunk to simulate a body.

    Attributes:
        floats: the body, then what changes.
        integers: the body, then what changes.
    """

    floats: Floats
    integers: Integers


class Simulation(NamedTuple):
    """State of a simulation of p parts and h joints, j of them with motors, and g grip sensors.

    Attributes:
        action: (j + g,).
        commands: (j, 2), as `command_motors` writes them.
        state: (p, 6).
        rotations: cosine and sine of each part's angle (p, 2).
        torques: of each motor, in N m (j,).
        forces: of the water on each part (p, 3), as `water_forces` writes them.
        points: where the sensors are (g, 2), in m.
        contacts: (p, 2).
        medium: consecutive steps under water and outside it (2,).
        wet: 1 if there are forces of water, else 0 (1,).
        grips: what each sensor touches and holds (g, 2).
        handles: pointers to the space, p bodies, j motors, h limits and h pivots (1 + p + j + 2 h,).
        holds: pointer to the pivot of each sensor that holds something, else 0 (g,).
    """

    action: Floats
    commands: Floats
    state: Floats
    rotations: Floats
    torques: Floats
    forces: Floats
    points: Floats
    contacts: Integers
    medium: Integers
    wet: Integers
    grips: Integers
    handles: Integers
    holds: Integers


def new_memory(body: StepArrays, all_joints: int, settings: SolverSettings, count_contact: int) -> Memory:
    """Returns the memory for a body, which is copied into it, with `all_joints` joints, passive ones too."""
    p, j, r = len(body.critical), len(body.motors), len(body.rays)
    v, g, h = len(body.vertices), len(body.grips), all_joints
    memory = Memory(
        np.zeros(FLOATS + (3 * j + 2 * r + 2 * v + 4 * p + 4 * j + 3 * g) + (4 * j + 3 * g + 11 * p)),
        np.zeros(
            INTEGERS + (2 + p + 3 * j + p + 1 + g) + (2 * p + 3 + 2 * g + 1 + p + j + 2 * h + g), np.int64
        ),
    )
    memory.integers[:SUBSTEPS] = p, j, r, v, g, h, body.head, body.observes_medium, body.may_touch_ceiling
    memory.integers[[SUBSTEPS, MOTOR_SUBSTEPS]] = settings.substeps, motor_substeps(settings)
    memory.integers[COUNT_CONTACT] = count_contact
    memory.floats[:2] = body.torque_cost, body.upright_weight
    memory.floats[[DURATION, ERROR_BIAS]] = TIME_STEP / settings.substeps, settings.joint_error_bias
    copy = body_in(memory.floats, memory.integers)
    for name, value in body._asdict().items():
        if isinstance(value, np.ndarray):
            getattr(copy, name)[:] = value
    simulation_in(memory.floats, memory.integers).grips[:] = NOTHING
    return memory


def put_world(memory: Memory, world: World, swinging: Integers) -> None:
    """Writes the sizes and addresses of `world` and of its creepers' pointers to `memory`.

    The arrays must live as long as the memory is used.
    """
    memory.floats[[GOAL_X, WATER_Y, SWAY]] = world.goal_x, world.water_y, world.sway
    arrays = (world.ground, world.ceiling, world.creepers, world.poses, world.movable, swinging)
    sizes = len(world.ground), len(world.ceiling), len(world.creepers)
    memory.integers[TERRAIN : TERRAIN + 9] = *sizes, *(array.ctypes.data for array in arrays)


@kernel
def body_in(floats: Floats, integers: Integers) -> StepArrays:
    """Returns the body in a memory."""
    p, j, r, v, g = integers[0], integers[1], integers[2], integers[3], integers[4]
    rays = FLOATS + 3 * j
    vertices = rays + 2 * r
    bounds = vertices + 2 * v
    hinges = bounds + 4 * p
    critical = INTEGERS + 2
    joint_parts = critical + p
    contact_part = joint_parts + 2 * j
    first_vertex = contact_part + j
    return StepArrays(
        integers[6],
        integers[7],
        integers[8],
        cp.part(integers, INTEGERS, (2,)),
        cp.part(integers, critical, (p,)),
        cp.part(integers, joint_parts, (j, 2)),
        cp.part(integers, contact_part, (j,)),
        cp.part(integers, first_vertex, (p + 1,)),
        cp.part(integers, first_vertex + p + 1, (g,)),
        floats[0],
        floats[1],
        cp.part(floats, FLOATS, (j, 3)),
        cp.part(floats, rays, (r, 2)),
        cp.part(floats, vertices, (v, 2)),
        cp.part(floats, bounds, (p, 4)),
        cp.part(floats, hinges, (j, 4)),
        cp.part(floats, hinges + 4 * j, (g, 3)),
    )


@kernel
def simulation_in(floats: Floats, integers: Integers) -> Simulation:
    """Returns what changes in a memory."""
    p, j, r, v, g, h = integers[0], integers[1], integers[2], integers[3], integers[4], integers[5]
    action = FLOATS + 3 * j + 2 * r + 2 * v + 4 * p + 4 * j + 3 * g
    commands = action + j + g
    state = commands + 2 * j
    rotations = state + 6 * p
    torques = rotations + 2 * p
    forces = torques + j
    contacts = INTEGERS + 2 + p + 3 * j + p + 1 + g
    medium = contacts + 2 * p
    handles, many = medium + 3 + 2 * g, 1 + p + j + 2 * h
    return Simulation(
        cp.part(floats, action, (j + g,)),
        cp.part(floats, commands, (j, 2)),
        cp.part(floats, state, (p, 6)),
        cp.part(floats, rotations, (p, 2)),
        cp.part(floats, torques, (j,)),
        cp.part(floats, forces, (p, 3)),
        cp.part(floats, forces + 3 * p, (g, 2)),
        cp.part(integers, contacts, (p, 2)),
        cp.part(integers, medium, (2,)),
        cp.part(integers, medium + 2, (1,)),
        cp.part(integers, medium + 3, (g, 2)),
        cp.part(integers, handles, (many,)),
        cp.part(integers, handles + many, (g,)),
    )


@kernel
def world_in(floats: Floats, integers: Integers) -> tuple[World, Integers]:
    """Returns the world of a memory, and the pointers of its creepers (c, 3)."""
    grounds, ceilings, creepers = integers[TERRAIN], integers[TERRAIN + 1], integers[TERRAIN + 2]
    at = integers[TERRAIN + 3 :]
    world = World(
        carray(cp.as_pointer(at[0]), (grounds, 4), np.float64),
        carray(cp.as_pointer(at[1]), (ceilings, 4), np.float64),
        carray(cp.as_pointer(at[2]), (creepers, 4), np.float64),
        carray(cp.as_pointer(at[3]), (creepers, 4), np.float64),
        carray(cp.as_pointer(at[4]), creepers, np.int64),
        floats[SWAY],
        floats[WATER_Y],
        floats[GOAL_X],
    )
    return world, carray(cp.as_pointer(at[5]), (creepers, 3), np.int64)
