"""What every environment promises with every body: later ones are tested by being registered."""

import hashlib
import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as gymnasium_check
from stable_baselines3.common.env_checker import check_env as stable_baselines_check
from suite.bodies import FEW, body

from tma_ray.embodiments import embodiment_names
from tma_ray.envs import ENVIRONMENTS, Environment, make_environment
from tma_ray.physics import engine_in_use
from tma_ray.tasks import TaskSpace

WORLDS = ENVIRONMENTS.names()
CATALOGUE = [(name, each) for name in WORLDS for each in embodiment_names()]
every_one = pytest.mark.parametrize(("name", "body"), [body(*pair) for pair in CATALOGUE])
together = pytest.mark.parametrize(
    "catalogue",
    [
        pytest.param([(name, each) for name in WORLDS for each in FEW], id="few"),
        pytest.param(CATALOGUE, id="all", marks=pytest.mark.slow),
    ],
)

HELPERS = [str(Path(__file__).parent), str(Path(__file__).parents[1])]


def play(env: Environment, seed: int, steps: int = 300) -> str:
    """Return a hash of everything that a random player of `seed` gets to see over several episodes."""
    rng, content = np.random.default_rng(seed), hashlib.sha256()
    observation, info = env.reset(seed=seed)
    for _ in range(steps):
        content.update(observation.tobytes())
        content.update(repr(info).encode())
        action = rng.uniform(-1, 1, env.action_space.shape).astype(np.float32)
        observation, reward, terminated, truncated, info = env.step(action)
        content.update(np.float64(reward).tobytes())
        if terminated or truncated:
            observation, info = env.reset()
    return content.hexdigest()


@cache
def played_anew(name: str, body: str) -> str:
    """Return the hash of an environment that has played nothing before."""
    return play(make_environment(name, embodiment=body), 1)


def walk(env: Environment, steps: int, draw: bool = False, task: object = None) -> list[np.ndarray]:
    """Return the observations of `steps` random actions, over as many episodes as they take."""
    rng = np.random.default_rng(0)
    observations = [env.reset(seed=0, options={"task": task})[0]]
    for _ in range(steps):
        if draw:
            env.render()
        action = rng.uniform(-1, 1, env.action_space.shape).astype(np.float32)
        observation, _, terminated, truncated, _ = env.step(action)
        observations.append(env.reset()[0] if terminated or truncated else observation)
    return observations


@pytest.mark.parametrize("name", ENVIRONMENTS.names())
def test_gymnasium_accepts_it(name: str) -> None:
    gymnasium_check(make_environment(name))


@pytest.mark.parametrize("name", ENVIRONMENTS.names())
def test_stable_baselines_accepts_it(name: str) -> None:
    stable_baselines_check(make_environment(name, render_mode="rgb_array"))


@every_one
def test_its_values_are_in_its_spaces(name: str, body: str) -> None:
    env = make_environment(name, embodiment=body)
    observation, _ = env.reset(seed=0)
    assert observation.dtype == np.float32
    assert observation in env.observation_space
    observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
    assert observation in env.observation_space
    assert type(reward) is float
    assert (type(terminated), type(truncated)) == (bool, bool)
    assert info == {"success": False}


@every_one
def test_it_repeats_bit_for_bit_whatever_came_before(name: str, body: str) -> None:
    env = make_environment(name, embodiment=body)
    assert play(env, 2) != played_anew(name, body)
    assert play(env, 1) == played_anew(name, body)


@pytest.mark.slow
@together
def test_all_repeat_bit_for_bit_in_another_process(catalogue: list[tuple[str, str]]) -> None:
    code = (
        "from test_environment_contract import play, make_environment\n"
        f"for name, body in {catalogue}:\n"
        "    print(play(make_environment(name, embodiment=body), 1))"
    )
    path = os.pathsep.join([*HELPERS, os.environ.get("PYTHONPATH", "")])
    environment = os.environ | {"PYTHONPATH": path, "PYTHONHASHSEED": "7"}
    result = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    assert result.stdout.split() == [played_anew(name, body) for name, body in catalogue]


@together
def test_both_engines_give_the_same_bits(
    monkeypatch: pytest.MonkeyPatch, catalogue: list[tuple[str, str]]
) -> None:
    seen: dict[str, list[str]] = {}
    for engine in ("compiled", "pymunk"):
        monkeypatch.setenv("TMA_RAY_ENGINE", engine)
        engine_in_use.cache_clear()
        assert engine_in_use().name == engine
        environments = [make_environment(name, embodiment=body) for name, body in catalogue]
        seen[engine] = [play(environment, 3) for environment in environments]
    engine_in_use.cache_clear()
    assert seen["compiled"] == seen["pymunk"]


@every_one
def test_it_declares_its_tasks(name: str, body: str) -> None:
    env = make_environment(name, embodiment=body)
    assert isinstance(env.task_space, TaskSpace)
    assert env.valid_domain.contains(env.task_space.low)
    assert env.valid_domain.contains(env.task_space.high)
    rng = np.random.default_rng(0)
    for task in env.valid_domain.sample(rng, 5):
        observation, info = env.reset(seed=0, options={"task": task})
        assert observation in env.observation_space
        np.testing.assert_array_equal(info["task"], task)
        assert info["success"] is False


@every_one
def test_what_it_returned_does_not_change_later(name: str, body: str) -> None:
    env = make_environment(name, embodiment=body)
    first, _ = env.reset(seed=0)
    second, *_ = env.step(np.zeros(env.action_space.shape, np.float32))
    kept = first.copy(), second.copy()
    walk(env, 5)
    np.testing.assert_array_equal((first, second), kept)


@every_one
def test_global_random_state_is_left_alone(name: str, body: str) -> None:
    state = np.random.get_state()[1].tobytes()  # noqa: NPY002
    play(make_environment(name, embodiment=body), 0, steps=20)
    assert np.random.get_state()[1].tobytes() == state  # noqa: NPY002


@every_one
def test_it_draws_its_world(name: str, body: str) -> None:
    env = make_environment(name, embodiment=body, render_mode="rgb_array")
    env.reset(seed=0)
    frame = env.render()
    assert frame.shape == (400, 600, 3)
    assert frame.dtype == np.uint8
    colours = frame.astype(np.uint32) @ np.array([2**16, 2**8, 1], np.uint32)
    assert len(np.unique(colours)) > 20
    walk(env, 10)
    assert not np.array_equal(env.render(), frame)
    env.close()


@every_one
def test_rendering_changes_nothing(name: str, body: str) -> None:
    plain, drawn = (make_environment(name, embodiment=body, render_mode=mode) for mode in (None, "rgb_array"))
    np.testing.assert_array_equal(walk(plain, 8), walk(drawn, 8, draw=True))


@every_one
def test_gymnasiums_vector_environment_runs_it(name: str, body: str) -> None:
    vector = gymnasium.vector.SyncVectorEnv([lambda: make_environment(name, embodiment=body)] * 2)
    observations, infos = vector.reset(seed=[0, 1])
    assert observations.shape == (2, *vector.single_observation_space.shape)
    assert infos["task"].shape[0] == 2


@pytest.mark.parametrize("name", ENVIRONMENTS.names())
def test_tasks_outside_its_valid_domain_are_refused_by_the_name_of_their_dimension(name: str) -> None:
    env = make_environment(name)
    domain, inside = env.valid_domain, (env.task_space.low + env.task_space.high) / 2
    for index, dimension in enumerate(domain.names):
        for value in (domain.low[index] - 0.1, domain.high[index] + 0.1, np.nan, np.inf):
            task = inside.copy()
            task[index] = value
            with pytest.raises(ValueError, match=rf"\b{dimension}\b"):
                env.reset(options={"task": task})
    env.reset(options={"task": inside})


@pytest.mark.parametrize("name", ENVIRONMENTS.names())
def test_tasks_of_another_shape_are_refused(name: str) -> None:
    env = make_environment(name)
    task = env.task_space.low
    for wrong in (task[:-1], np.append(task, 0.0), task[None], 1.0):
        with pytest.raises(ValueError, match="shape"):
            env.reset(options={"task": wrong})


@pytest.mark.parametrize("name", ENVIRONMENTS.names())
def test_the_corners_of_its_valid_domain_can_be_played(name: str) -> None:
    env = make_environment(name)
    for corner in (env.valid_domain.low, env.valid_domain.high):
        walk(env, 10, task=corner)


@every_one
def test_a_seed_decides_task_world_and_push(name: str, body: str) -> None:
    env = make_environment(name, embodiment=body)
    first, info = env.reset(seed=4)
    again, same = env.reset(seed=4)
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(info["task"], same["task"])
    assert not np.array_equal(env.reset(seed=5)[1]["task"], info["task"])
