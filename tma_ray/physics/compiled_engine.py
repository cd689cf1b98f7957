"""Chipmunk's C functions inside one compiled call: fast, and bit for bit the same as the pymunk engine."""

from __future__ import annotations

import math
import weakref
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tma_ray.embodiments import Embodiment
from tma_ray.physics import symbols
from tma_ray.physics.arrays import StepArrays, observation_size, step_arrays
from tma_ray.physics.chipmunk import settled
from tma_ray.physics.engine import GRAVITY, TIME_STEP, SolverSettings
from tma_ray.physics.jit import kernel
from tma_ray.physics.kernels import command_motors, judge, observe
from tma_ray.physics.world import Handles, build, count_contact, release
from tma_ray.terrain import Terrain

Floats = NDArray[np.float64]

symbols.load()


class Simulation(NamedTuple):
    """What a step reads and writes, besides the body.

    Attributes:
        handles: pointers into Chipmunk, as world.py orders them.
        clock: length of a substep in s, and substeps (2,).
        surface: of the terrain (m, 4).
        progress: shaping after the latest step, and x of the goal (2,).
        action: (j,).
        commands: (j, 2).
        state: (p, 6).
        contacts: (p,).
    """

    handles: Handles
    clock: Floats
    surface: Floats
    progress: Floats
    action: Floats
    commands: Floats
    state: Floats
    contacts: NDArray[np.int64]


@kernel
def advance(world: Simulation, count_contact: int) -> None:
    """Lets a time step pass under `world.commands`, and writes the new state and contacts."""
    parts, joints = len(world.state), len(world.commands)
    for joint in range(joints):
        motor = world.handles[1 + parts + joint]
        # Chipmunk's rate is the speed of the first part relative to the second.
        symbols.motor_set_rate(motor, -world.commands[joint, 0])
        symbols.constraint_set_max_force(motor, world.commands[joint, 1])
    for _ in range(int(world.clock[1])):
        symbols.space_step(world.handles[0], world.clock[0])
    for part in range(parts):
        body = world.handles[1 + part]
        values = world.state[part]
        values[0], values[1] = symbols.body_position(body)
        values[2] = symbols.body_angle(body)
        values[3], values[4] = symbols.body_velocity(body)
        values[5] = symbols.body_angular_velocity(body)
        world.contacts[part] = 0
        symbols.body_each_arbiter(body, count_contact, world.contacts[part:].ctypes.data)


@kernel
def step(observation: NDArray[np.float32], count_contact: int, *arrays: Any) -> tuple[float, bool]:
    """Runs a whole step: motors, simulation, observation and reward.

    Args:
        observation: (o,), written.
        count_contact: address of the function of that name.
        arrays: the fields of a Simulation, then those of the body's StepArrays; one by one, since numba
            takes five times as long to receive a named tuple.

    Returns:
        Reward, NaN if the action was not finite and nothing happened; end of the episode.
    """
    world, body = Simulation(*arrays[:8]), StepArrays(*arrays[8:])
    cost = command_motors(world.action, body, world.commands)
    if math.isnan(cost):
        return cost, False
    advance(world, count_contact)
    observe(world.state, world.contacts, body, world.surface, observation)
    before, goal_x = world.progress
    reward, ended, world.progress[0] = judge(world.state, world.contacts, body, goal_x, cost, before)
    return reward, ended


class CompiledEngine:
    """Runs a body on Chipmunk; see `Engine`.

    A copy or a pickle of it has the same body, and no world until it is reset.

    Args:
        body: the body.
        lidar_angles: directions of the rays (r,), in rad; 0 is straight down, pi/2 forward.
        settings: how Chipmunk solves.
    """

    def __init__(
        self, body: Embodiment, lidar_angles: NDArray[np.float64], settings: SolverSettings | None = None
    ) -> None:
        self.settings = settings or SolverSettings()
        self.state = np.zeros((len(body.parts), 6))
        self.contacts = np.zeros(len(body.parts), dtype=np.int64)
        self.arrays = step_arrays(body, lidar_angles)
        self._recipe = (body, lidar_angles, self.settings)
        self._body = settled(body, self.settings)
        self._observation_size = observation_size(self.arrays)
        self._action = np.zeros(body.action_size)
        self._shape = self._action.shape
        self._commands = np.zeros((body.action_size, 2))
        self._clock = np.array([TIME_STEP / self.settings.substeps, self.settings.substeps])
        self._count_contact = count_contact.address
        self._release: Any = None

    def reset(self, terrain: Terrain, push: float) -> NDArray[np.float32]:
        """Builds a new world and lets one step without torque pass; see `Engine`."""
        if self._release is not None:
            self._release()
        handles = build(self._body, terrain, self.settings, GRAVITY, push * TIME_STEP)
        self._release = weakref.finalize(self, release, handles, len(self.state), len(self._action))
        progress = np.array([0.0, terrain.goal_x])
        buffers = (self._action, self._commands, self.state, self.contacts)
        self._world = Simulation(handles, self._clock, terrain.surface, progress, *buffers)
        self._arguments = (self._count_contact, *self._world, *self.arrays)
        return self.step(np.zeros(self._shape))[0]

    def step(self, action: ArrayLike) -> tuple[NDArray[np.float32], float, bool]:
        """Advances the world by TIME_STEP; see `Engine`."""
        values = np.asarray(action)
        if values.shape != self._shape:
            raise ValueError(f"an action has shape {self._shape}, got {values.shape}")
        self._action[:] = values
        observation = np.empty(self._observation_size, np.float32)
        reward, ended = step(observation, *self._arguments)
        if reward != reward:
            raise ValueError(f"an action must be finite, got {values.tolist()}")
        return observation, reward, ended

    def __reduce__(self) -> tuple[type[CompiledEngine], tuple[Any, ...]]:
        return CompiledEngine, self._recipe
