"""A whole environment step in one compiled call."""

from __future__ import annotations

import math

import numpy as np
from numba import carray  # type: ignore[attr-defined]
from numpy.typing import NDArray

import tma_ray.physics.compiled.symbols as cp
from tma_ray.jit import kernel
from tma_ray.physics.compiled.memory import (
    BEFORE,
    COUNT_CONTACT,
    DURATION,
    ERROR_BIAS,
    MOTOR_SUBSTEPS,
    SUBSTEPS,
    Floats,
    Integers,
    Simulation,
    body_in,
    simulation_in,
    world_in,
)
from tma_ray.physics.grips import NOTHING, feel, holder_anchor
from tma_ray.physics.kernels import breathe, command_motors, judge, observe, survives
from tma_ray.physics.rules import StepArrays
from tma_ray.physics.water import water_forces
from tma_ray.physics.world import World


@kernel
def drive(simulation: Simulation, share: float) -> None:
    """Commands the motors, with their torques times `share`."""
    for joint in range(len(simulation.commands)):
        motor = simulation.handles[1 + len(simulation.state) + joint]
        # Chipmunk's rate is the speed of the first part relative to the second.
        cp.motor_set_rate(motor, -simulation.commands[joint, 0])
        cp.constraint_set_max_force(motor, share * simulation.commands[joint, 1])


@kernel
def read_torques(simulation: Simulation, duration: float) -> None:
    """Reads the motors' torques from their impulses, which are spread over `duration` s."""
    for joint in range(len(simulation.commands)):
        motor = simulation.handles[1 + len(simulation.state) + joint]
        torque = cp.constraint_impulse(motor) / duration
        simulation.torques[joint] = math.copysign(torque, simulation.commands[joint, 0])


@kernel
def advance(
    simulation: Simulation, substeps: int, motor_substeps: int, duration: float, count_contact: int
) -> None:
    """Lets `substeps` of `duration` s pass under motors and water, then reads state and contacts."""
    parts, share = len(simulation.state), substeps / motor_substeps
    for index in range(substeps):
        if index == 0:
            drive(simulation, share)
        elif index == motor_substeps:
            drive(simulation, 0.0)
        if simulation.wet[0]:  # Chipmunk forgets forces after each step
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
    """Reads where the creepers are that swing."""
    for index in range(len(swinging)):
        if swinging[index, 0] != 0:
            pose = world.poses[index]
            pose[0], pose[1] = cp.body_position(swinging[index, 0])
            pose[2], pose[3] = cp.body_rotation(swinging[index, 0])


@kernel
def turn(simulation: Simulation) -> None:
    """Reads the rotations of the parts."""
    for part in range(len(simulation.state)):
        rotation = simulation.rotations[part]
        rotation[0], rotation[1] = cp.body_rotation(simulation.handles[1 + part])


@kernel
def soak(simulation: Simulation, body: StepArrays, water_y: float) -> None:
    """Finds the forces of the water for the next step, if the body is near it."""
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
def let_go(simulation: Simulation) -> None:
    """Opens the grips whose action is not positive."""
    joints = len(simulation.commands)
    for sensor in range(len(simulation.holds)):
        hold = simulation.holds[sensor]
        if simulation.action[joints + sensor] <= 0 and hold != 0:
            cp.space_remove_constraint(simulation.handles[0], hold)
            cp.constraint_free(hold)
            simulation.holds[sensor], simulation.grips[sensor, 1] = 0, NOTHING


@kernel
def take_hold(
    simulation: Simulation, body: StepArrays, world: World, swinging: Integers, error_bias: float
) -> None:
    """Closes the grips whose action is positive on what they touch."""
    joints, grips = len(simulation.commands), simulation.grips
    feel(simulation.state, simulation.rotations, body, world, simulation.points, grips)
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
    """Runs a step under the action in the memory: motors, simulation, grips, water, observation and reward.

    Args:
        floats: of the memory.
        integers: of the memory.
        observation: written (o,).

    Returns:
        Reward, NaN if the action was not finite and nothing happened; end of the episode.
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
    breathe(state, world.water_y, body, medium)
    reward, ended, floats[BEFORE] = judge(state, contacts, body, world.goal_x, cost, floats[BEFORE])
    return reward, ended


@kernel
def step_at(
    floats_at: int, floats_size: int, integers_at: int, integers_size: int, observation: NDArray[np.float32]
) -> tuple[float, bool]:
    """Runs a step of the memory at two addresses; numba counts no references to arrays that it made."""
    floats = carray(cp.as_pointer(floats_at), floats_size, np.float64)
    integers = carray(cp.as_pointer(integers_at), integers_size, np.int64)
    return step(floats, integers, observation)
