"""Chipmunk's C functions inside one compiled call: fast, and bit for bit the same as the pymunk engine."""

from __future__ import annotations

import math
import weakref
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tma_ray.embodiments import Embodiment
from tma_ray.physics.chipmunk import hung, settled
from tma_ray.physics.compiled.memory import BEFORE, new_memory, put_world, simulation_in
from tma_ray.physics.compiled.step import step_at
from tma_ray.physics.compiled.world import build, count_contact, release
from tma_ray.physics.creepers import chains
from tma_ray.physics.engine import GRAVITY, TIME_STEP, SolverSettings, first_steps, settings_for
from tma_ray.physics.grips import NOTHING
from tma_ray.physics.rules import Rules, observation_size, step_arrays
from tma_ray.physics.world import world_of
from tma_ray.terrain import Terrain

COUNT_CONTACT = cast("int", count_contact.address)
"""Address of the function that Chipmunk calls for every contact."""


class CompiledEngine:
    """Runs a body on Chipmunk; see `Engine`.

    A copy or a pickle of it has the same body, and no world until it is reset.

    Args:
        body: the body.
        rules: of the environment.
        settings: how Chipmunk solves, if not as usual with the body's substeps.
    """

    def __init__(self, body: Embodiment, rules: Rules, settings: SolverSettings | None = None) -> None:
        self.settings = settings or settings_for(body)
        self.arrays = step_arrays(body, rules)
        self._recipe = (body, rules, self.settings)
        self._body = settled(body, self.settings)
        self._memory = new_memory(self.arrays, len(self._body.limits), self.settings, COUNT_CONTACT)
        floats, integers = self._memory
        self._addresses = floats.ctypes.data, len(floats), integers.ctypes.data, len(integers)
        self._simulation = simulation = simulation_in(*self._memory)
        self.state, self.contacts = simulation.state, simulation.contacts
        self.grips, self.medium = simulation.grips, simulation.medium
        self._action, self._action_shape = simulation.action, simulation.action.shape
        self._observation_size = observation_size(self.arrays)
        self._release: Any = None

    def reset(self, terrain: Terrain, push: float) -> NDArray[np.float32]:
        """Builds a new world and lets the first step pass; see `Engine`."""
        if self._release is not None:
            self._release()
            self._release = None  # no step in a world that is gone, should the next not come about
        hangs = len(self.grips) > 0 and len(terrain.ceiling) > 0
        if hangs:
            terrain = hung(terrain, self._body, self.arrays)
        self._build(terrain, push)
        return first_steps(self, hangs)

    def step(self, action: ArrayLike) -> tuple[NDArray[np.float32], float, bool]:
        """Advances the world by TIME_STEP; see `Engine`."""
        values = np.asarray(action)
        if self._release is None:
            raise RuntimeError("this engine has no world yet: call reset first")
        if values.shape != self._action_shape:
            raise ValueError(f"an action has shape {self._action_shape}, got {values.shape}")
        self._action[:] = values
        observation = np.empty(self._observation_size, np.float32)
        reward, ended = step_at(*self._addresses, observation)
        if math.isnan(reward):
            raise ValueError(f"an action must be finite, got {values.tolist()}")
        return observation, reward, ended

    @property
    def creeper_poses(self) -> NDArray[np.float64]:
        """Poses of the creepers (c, 4); see `Engine`."""
        if self._release is None:
            raise RuntimeError("this engine has no world yet: call reset first")
        return self._world[0].poses

    @property
    def addresses(self) -> tuple[int, ...]:
        """Addresses of the present world's memory, as `step_worlds` takes them."""
        if self._release is None:
            raise RuntimeError("this engine has no world yet: call reset first")
        return self._addresses

    def _build(self, terrain: Terrain, push: float) -> None:
        simulation, forces = self._simulation, (GRAVITY, push * TIME_STEP)
        simulation.grips[:], simulation.holds[:], simulation.medium[:] = NOTHING, 0, 0
        simulation.wet[:] = 0
        shapes, swinging = build(
            self._body, terrain, chains(terrain), self.settings, forces, simulation.handles
        )
        handles = simulation.handles.copy()
        self._release = weakref.finalize(
            self, release, handles, simulation.holds, shapes, swinging, len(self.state)
        )
        self._world = world_of(terrain), swinging  # whose addresses the memory has
        put_world(self._memory, *self._world)
        self._memory.floats[BEFORE] = 0.0

    def __reduce__(self) -> tuple[type[CompiledEngine], tuple[Any, ...]]:
        return CompiledEngine, self._recipe
