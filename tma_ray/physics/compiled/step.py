"""Step of an environment as one compiled function."""

import math
from typing import NamedTuple

import numpy as np
from numba import carray  # type: ignore[attr-defined]
from numpy.typing import NDArray

import tma_ray.physics.compiled.symbols as cp
from tma_ray.physics.base import TIME_STEP, SolverSettings, motor_substeps
from tma_ray.physics.kernels import (
    NOTHING,
    World,
    command_motors,
    count_breath,
    holder_anchor,
    observe,
    step_outcome,
    survives,
    update_grip_contacts,
    water_forces,
)
from tma_ray.physics.rules import StepArrays
from tma_ray.support.jit import kernel

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

FLOATS, INTEGERS = 8, 21
"""Numbers of scalars at the start of a memory's two vectors, before the arrays of body and simulation."""

DURATION, ERROR_BIAS, BEFORE, GOAL_X, WATER_Y, SWAY = 2, 3, 4, 5, 6, 7
"""Indices into `Memory.floats`, after the cost of torques and the weight of the upright reward."""

SUBSTEPS, MOTOR_SUBSTEPS, COUNT_CONTACT, TERRAIN = 9, 10, 11, 12
"""Indices into `Memory.integers`, after sizes; sizes and addresses of the world's arrays begin at TERRAIN."""


class Memory(NamedTuple):
    """Body, simulation state and addresses of a world's arrays, packed in two vectors for a compiled step.

    Unboxing twenty arrays would take numba longer than Chipmunk takes to simulate a body.
    """

    floats: Floats
    integers: Integers


class SimulationState(NamedTuple):
    """State of a simulation of p parts and h joints, j of them with motors, and g grip sensors."""

    action: Floats  # action (j + g,)
    commands: Floats  # commands of the motors (j, 2), written by `command_motors`
    state: Floats  # state of the parts (p, 6), as in kernels.py
    rotations: Floats  # cosine and sine of the angle of each part (p, 2)
    torques: Floats  # torque of each motor, in N m (j,)
    forces: Floats  # forces of the water on each part (p, 3), written by `water_forces`
    points: Floats  # positions of the sensors (g, 2), in m
    contacts: Integers  # numbers of ground and of ceiling solids that each part touches (p, 2)
    medium: Integers  # consecutive steps under water and outside it (2,)
    wet: Integers  # 1 if the water exerts forces, otherwise 0 (1,)
    grips: Integers  # object that each sensor touches and holds (g, 2)
    handles: Integers  # pointers to the space, p bodies, j motors, h limits and h pivots (1 + p + j + 2 h,)
    holds: Integers  # pointer to the pivot of each closed grip, 0 for open grips (g,)


def new_memory(body: StepArrays, all_joints: int, settings: SolverSettings, count_contact: int) -> Memory:
    """Return a new memory with a copy of `body`, which has `all_joints` joints, passive ones included."""
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
    """Store the addresses and sizes of the arrays of `world` in `memory`; `world` must outlive `memory`."""
    memory.floats[[GOAL_X, WATER_Y, SWAY]] = world.goal_x, world.water_y, world.sway
    arrays = (world.ground, world.ceiling, world.creepers, world.poses, world.movable, swinging)
    sizes = len(world.ground), len(world.ceiling), len(world.creepers)
    memory.integers[TERRAIN : TERRAIN + 9] = *sizes, *(array.ctypes.data for array in arrays)


@kernel
def body_in(floats: Floats, integers: Integers) -> StepArrays:
    """Return the body's constants as views of a memory."""
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
def simulation_in(floats: Floats, integers: Integers) -> SimulationState:
    """Return the simulation's state as views of a memory."""
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
    return SimulationState(
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
    """Return the world whose addresses are in a memory, and the pointers to its creepers (c, 3)."""
    grounds, ceilings, creepers = integers[TERRAIN], integers[TERRAIN + 1], integers[TERRAIN + 2]
    addresses = integers[TERRAIN + 3 :]
    world = World(
        carray(cp.as_pointer(addresses[0]), (grounds, 4), np.float64),
        carray(cp.as_pointer(addresses[1]), (ceilings, 4), np.float64),
        carray(cp.as_pointer(addresses[2]), (creepers, 4), np.float64),
        carray(cp.as_pointer(addresses[3]), (creepers, 4), np.float64),
        carray(cp.as_pointer(addresses[4]), creepers, np.int64),
        floats[SWAY],
        floats[WATER_Y],
        floats[GOAL_X],
    )
    return world, carray(cp.as_pointer(addresses[5]), (creepers, 3), np.int64)


@kernel
def drive(simulation: SimulationState, share: float) -> None:
    """Set the motors' target speeds, and their largest torques multiplied by `share`."""
    for joint in range(len(simulation.commands)):
        motor = simulation.handles[1 + len(simulation.state) + joint]
        # Chipmunk's rate is the speed of the first part relative to the second
        cp.motor_set_rate(motor, -simulation.commands[joint, 0])
        cp.constraint_set_max_force(motor, share * simulation.commands[joint, 1])


@kernel
def read_torques(simulation: SimulationState, duration: float) -> None:
    """Compute the motors' torques from their impulses over `duration` s."""
    for joint in range(len(simulation.commands)):
        motor = simulation.handles[1 + len(simulation.state) + joint]
        torque = cp.constraint_impulse(motor) / duration
        simulation.torques[joint] = math.copysign(torque, simulation.commands[joint, 0])


@kernel
def advance(
    simulation: SimulationState, substeps: int, motor_substeps: int, duration: float, count_contact: int
) -> None:
    """Run `substeps` of `duration` s with motors and water, then read state and contacts from Chipmunk."""
    parts, share = len(simulation.state), substeps / motor_substeps
    for index in range(substeps):
        if index == 0:
            drive(simulation, share)
        elif index == motor_substeps:
            drive(simulation, 0.0)
        if simulation.wet[0]:  # Chipmunk resets forces after each step
            for part in range(parts):
                body, force = simulation.handles[1 + part], simulation.forces[part]
                cp.body_set_force(body, force[0], force[1])
                cp.body_set_torque(body, force[2])
        cp.space_step(simulation.handles[0], duration)
        if index == motor_substeps - 1:
            read_torques(simulation, duration * share)
    for part in range(parts):
        body, values = simulation.handles[1 + part], simulation.state[part]
        values[0], values[1] = cp.body_position(body)
        values[2] = cp.body_angle(body)
        values[3], values[4] = cp.body_velocity(body)
        values[5] = cp.body_angular_velocity(body)
        simulation.contacts[part] = 0
        cp.body_each_arbiter(body, count_contact, simulation.contacts[part:].ctypes.data)


@kernel
def move_creepers(world: World, swinging: Integers) -> None:
    """Read the poses of the swinging creepers from Chipmunk."""
    for index in range(len(swinging)):
        if swinging[index, 0] != 0:
            pose = world.poses[index]
            pose[0], pose[1] = cp.body_position(swinging[index, 0])
            pose[2], pose[3] = cp.body_rotation(swinging[index, 0])


@kernel
def turn(simulation: SimulationState) -> None:
    """Read the rotations of the parts from Chipmunk."""
    for part in range(len(simulation.state)):
        rotation = simulation.rotations[part]
        rotation[0], rotation[1] = cp.body_rotation(simulation.handles[1 + part])


@kernel
def soak(simulation: SimulationState, body: StepArrays, water_y: float) -> None:
    """Compute the forces of the water on the body for the next step."""
    lowest = math.inf
    for part in range(len(simulation.state)):
        lowest = min(lowest, simulation.state[part, 1] - body.bounds[part, 0])
    near = lowest < water_y
    if near or len(body.grips) > 0:
        turn(simulation)
    simulation.wet[0] = 0
    if near:
        wet = water_forces(
            simulation.state, simulation.rotations, simulation.torques, body, water_y, simulation.forces
        )
        simulation.wet[0] = 1 if wet else 0


@kernel
def let_go(simulation: SimulationState) -> None:
    """Open each grip whose action is not positive."""
    joints = len(simulation.commands)
    for sensor in range(len(simulation.holds)):
        hold = simulation.holds[sensor]
        if simulation.action[joints + sensor] <= 0 and hold != 0:
            cp.space_remove_constraint(simulation.handles[0], hold)
            cp.constraint_free(hold)
            simulation.holds[sensor], simulation.grips[sensor, 1] = 0, NOTHING


@kernel
def take_hold(
    simulation: SimulationState, body: StepArrays, world: World, swinging: Integers, error_bias: float
) -> None:
    """Close each grip with a positive action around the object that it touches, if any."""
    joints, grips = len(simulation.commands), simulation.grips
    update_grip_contacts(simulation.state, simulation.rotations, body, world, simulation.points, grips)
    for sensor in range(len(simulation.holds)):
        touched = grips[sensor, 0]
        closing = simulation.action[joints + sensor] > 0 and simulation.holds[sensor] == 0
        if closing and touched != NOTHING:
            holder = cp.space_static_body(simulation.handles[0])
            if touched >= 0 and world.movable[touched]:
                holder = swinging[touched, 0]
            x, y = holder_anchor(simulation.points[sensor], touched, world)
            part = simulation.handles[1 + body.grip_part[sensor]]
            pivot = cp.pivot_new(holder, part, x, y, body.grips[sensor, 0], body.grips[sensor, 1])
            cp.constraint_set_error_bias(pivot, error_bias)
            cp.space_add_constraint(simulation.handles[0], pivot)
            simulation.holds[sensor], grips[sensor, 1] = pivot, touched


@kernel
def step(floats: Floats, integers: Integers, observation: NDArray[np.float32]) -> tuple[float, bool]:
    """Run a step with the action in the memory, and write the `observation` (o,).

    Returns:
        Reward, NaN if the action is not finite and nothing has moved, and True at the end of the episode.
    """
    body, simulation = body_in(floats, integers), simulation_in(floats, integers)
    world, swinging = world_in(floats, integers)
    alive = survives(simulation.medium, body)
    cost = command_motors(simulation.action, alive, body, simulation.commands)
    if math.isnan(cost):
        return cost, False
    let_go(simulation)
    substeps, motor_substeps = integers[SUBSTEPS], integers[MOTOR_SUBSTEPS]
    advance(simulation, substeps, motor_substeps, floats[DURATION], integers[COUNT_CONTACT])
    move_creepers(world, swinging)
    soak(simulation, body, world.water_y)
    take_hold(simulation, body, world, swinging, floats[ERROR_BIAS])
    state, contacts, medium = simulation.state, simulation.contacts, simulation.medium
    observe(state, contacts, medium, simulation.grips, body, world, observation)
    count_breath(state, world.water_y, body, medium)
    reward, ended, floats[BEFORE] = step_outcome(state, contacts, body, world.goal_x, cost, floats[BEFORE])
    return reward, ended


@kernel
def step_at(
    floats_at: int, floats_size: int, integers_at: int, integers_size: int, observation: NDArray[np.float32]
) -> tuple[float, bool]:
    """Run a step on memory given by its addresses, without numba's reference counting."""
    floats = carray(cp.as_pointer(floats_at), floats_size, np.float64)
    integers = carray(cp.as_pointer(integers_at), integers_size, np.int64)
    return step(floats, integers, observation)
