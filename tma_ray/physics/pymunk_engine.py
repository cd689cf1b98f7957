"""Chipmunk through pymunk's public API: portable, and the oracle for faster engines."""

from __future__ import annotations

import math

import numpy as np
import pymunk
from numpy.typing import ArrayLike, NDArray
from pymunk import batch

from tma_ray.embodiments import Embodiment
from tma_ray.physics.arrays import observation_size, step_arrays
from tma_ray.physics.chipmunk import add_joints, add_parts, add_terrain, settled
from tma_ray.physics.engine import GRAVITY, TIME_STEP, SolverSettings
from tma_ray.physics.kernels import command_motors, judge, observe
from tma_ray.terrain import Terrain

STATE_FIELDS = (
    batch.BodyFields.POSITION
    | batch.BodyFields.ANGLE
    | batch.BodyFields.VELOCITY
    | batch.BodyFields.ANGULAR_VELOCITY
)


class PymunkEngine:
    """Runs a body on Chipmunk; see `Engine`.

    Args:
        body: the body.
        lidar_angles: directions of the rays (r,), in rad; 0 is straight down, pi/2 forward.
        settings: how Chipmunk solves, if not as usual with the body's substeps.
        environment: whose critical parts count.
    """

    def __init__(
        self,
        body: Embodiment,
        lidar_angles: NDArray[np.float64],
        settings: SolverSettings | None = None,
        environment: str = "stump_tracks",
    ) -> None:
        self.settings = settings or SolverSettings(substeps=body.substeps)
        self.state = np.zeros((len(body.parts), 6))
        self.contacts = np.zeros(len(body.parts), dtype=np.int64)
        self._body = settled(body, self.settings)
        self.arrays = step_arrays(body, lidar_angles, environment)
        self._observation_size = observation_size(self.arrays)
        self._action = np.zeros(body.action_size)
        self._commands = np.zeros((body.action_size, 2))
        self._buffer = batch.Buffer()
        self._space: pymunk.Space | None = None

    def reset(self, terrain: Terrain, push: float) -> NDArray[np.float32]:
        """Builds a new world and lets one step without torque pass; see `Engine`."""
        self._surface, self._goal_x = terrain.surface, terrain.goal_x
        self.contacts = np.zeros_like(self.contacts)
        # A new Space every time: a reused one keeps counters that change later trajectories.
        self._space = space = pymunk.Space()
        space.iterations = self.settings.iterations
        space.gravity = (0.0, GRAVITY)
        space.collision_slop = self.settings.collision_slop
        space.collision_bias = self.settings.collision_bias
        add_terrain(space, terrain)  # before the body: the order of insertion changes trajectories
        parts = add_parts(space, self._body, terrain.spawn, self.settings.skin_radius)
        self._motors, _ = add_joints(space, self._body, parts, self.settings)
        for part in range(len(parts)):
            space.on_collision(part + 1, None, begin=_touch, separate=_release, data=(self.contacts, part))
        for index in np.flatnonzero(self._body.pushed):
            centre = parts[index].center_of_gravity
            parts[index].apply_impulse_at_local_point((push * TIME_STEP, 0.0), centre)
        self._shaping = 0.0
        return self.step(np.zeros_like(self._action))[0]

    def step(self, action: ArrayLike) -> tuple[NDArray[np.float32], float, bool]:
        """Advances the world by TIME_STEP; see `Engine`."""
        values = np.asarray(action)
        if self._space is None:
            raise RuntimeError("this engine has no world yet: call reset first")
        if values.shape != self._action.shape:
            raise ValueError(f"an action has shape {self._action.shape}, got {values.shape}")
        self._action[:] = values
        cost = command_motors(self._action, self.arrays, self._commands)
        if math.isnan(cost):
            raise ValueError(f"an action must be finite, got {values.tolist()}")
        self._set_motors()
        for _ in range(self.settings.substeps):
            self._space.step(TIME_STEP / self.settings.substeps)
        self._read_state(self._space)
        observation = np.empty(self._observation_size, dtype=np.float32)
        observe(self.state, self.contacts, self.arrays, self._surface, observation)
        reward, terminated, self._shaping = judge(
            self.state, self.contacts, self.arrays, self._goal_x, cost, self._shaping
        )
        return observation, float(reward), bool(terminated)

    def _set_motors(self) -> None:
        for motor, (speed, torque) in zip(self._motors, self._commands.tolist(), strict=True):
            motor.rate = -speed  # Chipmunk's rate is the speed of the first part relative to the second
            motor.max_force = torque

    def _read_state(self, space: pymunk.Space) -> None:
        self._buffer.clear()
        batch.get_space_bodies(space, STATE_FIELDS, self._buffer)
        values = np.frombuffer(self._buffer.float_buf())  # the static body comes last
        self.state[:] = values[: self.state.size].reshape(self.state.shape)


def _touch(_arbiter: pymunk.Arbiter, _space: pymunk.Space, data: tuple[NDArray[np.int64], int]) -> None:
    contacts, part = data
    contacts[part] += 1


def _release(_arbiter: pymunk.Arbiter, _space: pymunk.Space, data: tuple[NDArray[np.int64], int]) -> None:
    contacts, part = data
    contacts[part] -= 1
