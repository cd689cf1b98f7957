"""Every body in every environment, over the whole valid domain: nothing breaks."""

import numpy as np
import pytest
from hardships import ACTIONS, DEEPEST, endure, tasks, through
from suite.bodies import bodies

from tma_ray.embodiments import embodiment_names, load_embodiment
from tma_ray.envs import ENVIRONMENTS, make_environment

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
            outcome = endure(env, task, kind, steps, seed)
            assert not outcome.troubles, (name, options, body, task.tolist(), kind)
            played += outcome.steps
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
        assert not endure(env, task, ACTIONS[seed % len(ACTIONS)], 2000, seed).troubles


@pytest.mark.parametrize("body", ["climbing_chimpanzee", "climbing_chest_chimpanzee", "quadrupedal:size=2"])
def test_who_does_not_fit_in_ends_in_a_defined_way(body: str) -> None:
    """The ceiling is 5 m over the start, lower than some bodies are high."""
    env = make_environment("parkour", embodiment=body)
    task = [0.0, 0.0, 0.0, 0.5, 0.25, 1.0, 1.0, CEILING_LOW]
    for seed, kind in enumerate(ACTIONS):
        outcome = endure(env, np.array(task, dtype=np.float32), kind, 300, seed)
        assert not outcome.troubles
        assert outcome.steps > 0


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
