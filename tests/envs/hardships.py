"""Episodes that ask much of the physics: tasks of the whole valid domain, and actions without mercy."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product
from typing import NamedTuple

import numpy as np

from tma_ray.envs.base import BodyEnvironment
from tma_ray.jit import kernel
from tma_ray.terrain import Terrain

DEEPEST = 0.5
"""A part's frame that is deeper in a solid than the part's own reach and this, in m, has gone through."""

FASTEST = 100.0
"""Nothing in these worlds is as fast, in m/s: a fall over their whole height ends at 60."""

ACTIONS = ("random", "all +1", "all -1", "bang-bang")


class Outcome(NamedTuple):
    """What an episode came to.

    Attributes:
        steps: how many it had.
        troubles: what must not be, in words.
    """

    steps: int
    troubles: set[str]


def tasks(env: BodyEnvironment, rng: np.random.Generator, inner: int, corners: int | None) -> np.ndarray:
    """Return `inner` tasks from within the valid domain and some of its corners (None: all)."""
    space = env.valid_domain
    every = np.array(list(product(*zip(space.low, space.high, strict=True))))
    chosen = (
        every if corners is None else every[rng.choice(len(every), min(corners, len(every)), replace=False)]
    )
    return np.concatenate([space.sample(rng, inner), chosen.astype(np.float32)])


def players(size: int, kind: str, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """Yield actions of a `kind`; bang-bang ones change sides every 10 steps."""
    constant, step = {"all +1": 1.0, "all -1": -1.0}, 0
    action = np.full(size, constant.get(kind, 0.0))
    while True:
        if kind == "random":
            action = rng.uniform(-1, 1, size)
        elif kind == "bang-bang" and step % 10 == 0:
            action = rng.choice([-1.0, 1.0], size)
        step += 1
        yield action


def endure(env: BodyEnvironment, task: np.ndarray, kind: str, steps: int, seed: int) -> Outcome:
    """Play an episode of at most `steps` and looks for what must not be."""
    rng, troubles = np.random.default_rng([seed, 9]), set()
    observation, _ = env.reset(seed=seed, options={"task": task})
    start = through(env._engine.state, env._engine.arrays.bounds[:, 0], env._terrain)
    troubles |= faults(env, observation, 0.0)
    count, over, player = 0, False, players(*env.action_space.shape, kind, rng)
    while count < steps and not over:
        observation, reward, terminated, truncated, _ = env.step(next(player))
        troubles |= faults(env, observation, reward)
        if not start:
            troubles |= through(env._engine.state, env._engine.arrays.bounds[:, 0], env._terrain)
        count, over = count + 1, terminated or truncated
    return Outcome(count, troubles)


def faults(env: BodyEnvironment, observation: np.ndarray, reward: float) -> set[str]:
    """Return what is wrong with the numbers of a step."""
    found = set()
    if not (
        np.all(np.isfinite(observation)) and np.all(np.isfinite(env._engine.state)) and np.isfinite(reward)
    ):
        found.add("not finite")
    if observation not in env.observation_space:
        found.add("observation outside its space")
    if np.abs(env._engine.state[:, 3:5]).max() > FASTEST:
        found.add("too fast")
    return found


def through(state: np.ndarray, reach: np.ndarray, terrain: Terrain) -> set[str]:
    """Return whether a part's frame is deeper in ground or ceiling than its own reach (p,) and DEEPEST.

    Depth is counted from the nearer end of the surface within the part's reach to both sides.
    """
    sides = (("ground", terrain.surface, 1.0), ("ceiling", terrain.ceiling, -1.0))
    return {f"through the {name}" for name, surface, side in sides if sunk(state, reach, surface, side)}


@kernel
def sunk(state: np.ndarray, reach: np.ndarray, surface: np.ndarray, side: float) -> bool:
    """Tell whether a part has gone through a surface; see `through`."""
    for part in range(len(state)):
        x, far, lowest = state[part, 0], reach[part], math.inf
        for left, left_y, right, right_y in surface:
            if left <= x + far and right >= x - far:
                lowest = min(lowest, side * left_y, side * right_y)
        if side * state[part, 1] < lowest - far - DEEPEST and lowest < math.inf:
            return True
    return False
