"""Chipmunk's C functions inside one compiled call: fast, and bit for bit the same as the pymunk engine."""

from __future__ import annotations

import math
import weakref
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tma_ray.embodiments import Embodiment
from tma_ray.physics.arrays import observation_size, step_arrays
from tma_ray.physics.chipmunk import settled
from tma_ray.physics.compiled_step import new_memory, step, views
from tma_ray.physics.compiled_world import build, count_contact, release
from tma_ray.physics.engine import GRAVITY, TIME_STEP, SolverSettings
from tma_ray.terrain import Terrain

COUNT_CONTACT = cast("int", count_contact.address)
"""Address of the function that Chipmunk calls for every contact."""


class CompiledEngine:
    """Runs a body on Chipmunk; see `Engine`.

    A copy or a pickle of it has the same body, and no world until it is reset.

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
        self.arrays = step_arrays(body, lidar_angles, environment)
        self._recipe = (body, lidar_angles, self.settings, environment)
        self._body = settled(body, self.settings)
        self._floats, self._integers = new_memory(self.arrays, len(self._body.limits))
        self._floats[2] = TIME_STEP / self.settings.substeps
        self._integers[4] = self.settings.substeps
        self._integers[5] = COUNT_CONTACT
        _, self._simulation = views(self._floats, self._integers)
        self.state, self.contacts = self._simulation.state, self._simulation.contacts
        self._action = self._simulation.action
        self._action_shape = self._action.shape
        self._observation_size = observation_size(self.arrays)
        self._release: Any = None

    def reset(self, terrain: Terrain, push: float) -> NDArray[np.float32]:
        """Builds a new world and lets one step without torque pass; see `Engine`."""
        if self._release is not None:
            self._release()
            self._release = None  # no step in a world that is gone, should the next not come about
        handles = self._simulation.handles
        shapes = build(self._body, terrain, self.settings, (GRAVITY, push * TIME_STEP), handles)
        self._release = weakref.finalize(self, release, handles.copy(), shapes, len(self.state))
        self._surface = terrain.surface
        self._floats[3:5] = 0.0, terrain.goal_x
        return self.step(np.zeros(self._action_shape))[0]

    def step(self, action: ArrayLike) -> tuple[NDArray[np.float32], float, bool]:
        """Advances the world by TIME_STEP; see `Engine`."""
        values = np.asarray(action)
        if self._release is None:
            raise RuntimeError("this engine has no world yet: call reset first")
        if values.shape != self._action_shape:
            raise ValueError(f"an action has shape {self._action_shape}, got {values.shape}")
        self._action[:] = values
        observation = np.empty(self._observation_size, np.float32)
        reward, ended = step(self._floats, self._integers, self._surface, observation)
        if math.isnan(reward):
            raise ValueError(f"an action must be finite, got {values.tolist()}")
        return observation, reward, ended

    @property
    def addresses(self) -> tuple[int, ...]:
        """Where memory and surface of the present world lie, as `step_worlds` takes them."""
        if self._release is None:
            raise RuntimeError("this engine has no world yet: call reset first")
        arrays = self._floats, self._integers, self._surface
        return tuple(value for array in arrays for value in (array.ctypes.data, len(array)))

    def __reduce__(self) -> tuple[type[CompiledEngine], tuple[Any, ...]]:
        return CompiledEngine, self._recipe
