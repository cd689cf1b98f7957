"""Every body in every environment, over the whole valid domain: nothing breaks."""

import math
from collections.abc import Iterator
from itertools import product

import numpy as np
import pytest
from suite.bodies import bodies

from tma_ray.embodiments import embodiment_names, load_embodiment
from tma_ray.envs import ENVIRONMENTS, make_environment
from tma_ray.envs.base import BodyEnvironment
from tma_ray.support.jit import kernel
from tma_ray.terrain import Terrain

DEEPEST = 0.5
"""A part's frame that is deeper in a solid than the part's own reach and this, in m, has gone through."""

FASTEST = 100.0
"""Nothing in these worlds is as fast, in m/s: a fall over their whole height ends at 60."""

ACTIONS = ("random", "all +1", "all -1", "bang-bang")


def tasks(env: BodyEnvironment, rng: np.random.Generator, inner: int, corners: int | None) -> np.ndarray:
    """Return `inner` tasks from within the valid domain and some of its corners (None: all)."""
    space = env.valid_domain
    every = np.array(list(product(*zip(space.low, space.high, strict=True))))
    chosen = every if corners is None else rng.choice(every, min(corners, len(every)), replace=False)
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


def endure(env: BodyEnvironment, task: np.ndarray, kind: str, steps: int, seed: int) -> tuple[int, set[str]]:
    """Play an episode of at most `steps`; return how many it had, and what must not be, in words."""
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
    return count, troubles


def faults(env: BodyEnvironment, observation: np.ndarray, reward: float) -> set[str]:
    """Return what is wrong with the numbers of a step."""
    found = set()
    if not all(np.all(np.isfinite(each)) for each in (observation, env._engine.state, reward)):
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


VARIANTS = [(name, options) for name in ENVIRONMENTS.names() for options in ({}, {"swinging_creepers": True})]
VARIANTS = [variant for variant in VARIANTS if variant[0] == "parkour" or not variant[1]]
CEILING_LOW = 40.0
"""The scale of the network at which the start's ceiling is 5 m over its ground."""


def survey(body: str, inner: int, corners: int | None, steps: int) -> int:
    """Play episodes in every variant, none with trouble, and return their steps."""
    played = 0
    for name, options in VARIANTS:
        env = make_environment(name, embodiment=body, **options)
        rng = np.random.default_rng(len(body))
        for seed, task in enumerate(tasks(env, rng, inner, corners)):
            kind = ACTIONS[seed % len(ACTIONS)]
            count, troubles = endure(env, task, kind, steps, seed)
            assert not troubles, (name, options, body, task.tolist(), kind)
            played += count
    return played


@pytest.mark.parametrize("body", bodies())
def test_a_little_of_everything(body: str) -> None:
    assert survey(body, inner=1, corners=4, steps=60) > 300


@pytest.mark.slow
@pytest.mark.parametrize("body", embodiment_names())
def test_all_corners_and_much_between(body: str) -> None:
    assert survey(body, inner=60, corners=None, steps=400) > 50_000


@pytest.mark.slow
@pytest.mark.parametrize("body", [f"{name}:size={size}" for name in embodiment_names() for size in (0.5, 2)])
def test_small_and_large_bodies(body: str) -> None:
    assert survey(body, inner=10, corners=40, steps=200) > 3000


@pytest.mark.slow
@pytest.mark.parametrize("body", embodiment_names())
def test_whole_episodes(body: str) -> None:
    env = make_environment("parkour", embodiment=body)
    rng = np.random.default_rng(0)
    for seed, task in enumerate(env.task_space.sample(rng, 8)):
        assert not endure(env, task, ACTIONS[seed % len(ACTIONS)], 2000, seed)[1]


@pytest.mark.parametrize("body", ["climbing_chimpanzee", "climbing_chest_chimpanzee", "quadrupedal:size=2"])
def test_who_does_not_fit_in_ends_in_a_defined_way(body: str) -> None:
    """The ceiling is 5 m over the start, lower than some bodies are high."""
    env = make_environment("parkour", embodiment=body)
    task = [0.0, 0.0, 0.0, 0.5, 0.25, 1.0, 1.0, CEILING_LOW]
    for seed, kind in enumerate(ACTIONS):
        count, troubles = endure(env, np.array(task, dtype=np.float32), kind, 300, seed)
        assert not troubles
        assert count > 0


def test_going_through_is_noticed() -> None:
    env = make_environment("parkour", embodiment="classic_bipedal")
    env.reset(seed=0)
    body = load_embodiment("classic_bipedal")
    state, reach = env._engine.state.copy(), env._engine.arrays.bounds[:, 0]
    assert through(state, reach, env._terrain) == set()
    state[body.head, 1] = env._terrain.spawn[1] - reach[body.head] - DEEPEST - 0.01
    assert through(state, reach, env._terrain) == {"through the ground"}
    state[body.head, 1] = env._terrain.ceiling[0, 1] + reach[body.head] + DEEPEST + 0.01
    assert through(state, reach, env._terrain) == {"through the ceiling"}
