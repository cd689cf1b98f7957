"""Every environment keeps the contract of the conformance kit with every body, and can be drawn."""

import copy
import hashlib
import os
import pickle
from pathlib import Path

import numpy as np
import pytest
from stable_baselines3.common.env_checker import check_env
from suite.bodies import FEW, body
from suite.processes import python

from tma_ray.conformance import EnvironmentConformance
from tma_ray.embodiments import embodiment_names
from tma_ray.envs import ENVIRONMENTS, Environment, make_environment
from tma_ray.physics.selection import EngineChoice

CATALOGUE = [(name, each) for name in ENVIRONMENTS.names() for each in embodiment_names()]
every_one = pytest.mark.parametrize(("name", "body"), [body(*pair) for pair in CATALOGUE])

for _name, _body in CATALOGUE:
    _members = {"environment": _name, "options": {"embodiment": _body}}
    _kit = type(f"Test_{_name}_{_body}", (EnvironmentConformance,), _members)
    globals()[_kit.__name__] = _kit if _body in FEW else pytest.mark.slow(_kit)


def walk(env: Environment, steps: int, draw: bool = False) -> list[tuple]:
    """Return what resets and `steps` random actions give, over as many episodes as they take."""
    rng = np.random.default_rng(1)
    seen = [env.reset(seed=1)]
    for _ in range(steps):
        if draw:
            env.render()
        seen.append(env.step(rng.uniform(-1, 1, env.action_space.shape).astype(np.float32)))
        if seen[-1][2] or seen[-1][3]:
            seen.append(env.reset())
    return seen


def played(name: str, body: str) -> str:
    """Return a hash of everything that a random player gets to see."""
    seen = walk(make_environment(name, embodiment=body), 300)
    content = b"".join(observation.tobytes() + repr(rest).encode() for observation, *rest in seen)
    return hashlib.sha256(content).hexdigest()


@pytest.mark.parametrize("name", ENVIRONMENTS.names())
def test_stable_baselines_accepts_it(name: str) -> None:
    check_env(make_environment(name, render_mode="rgb_array"))


@pytest.mark.slow
def test_all_repeat_bit_for_bit_in_another_process() -> None:
    code = "from test_environment_contract import *\nfor pair in CATALOGUE:\n    print(played(*pair))"
    folders = [str(Path(__file__).parents[level]) for level in (0, 1)]
    path = os.pathsep.join([*folders, os.environ.get("PYTHONPATH", "")])
    printed = python("-c", code, PYTHONPATH=path, PYTHONHASHSEED="7")
    assert printed.split() == [played(*pair) for pair in CATALOGUE]


@every_one
def test_what_it_returned_does_not_change_later(name: str, body: str) -> None:
    env = make_environment(name, embodiment=body)
    first, begun = env.reset(seed=0)
    second, *others = env.step(np.zeros(env.action_space.shape, np.float32))
    assert begun["success"] is False
    assert [type(each) for each in others] == [float, bool, bool, dict]
    assert others[-1].keys() - {"is_success"} == {"success", "task"}
    assert others[-1]["task"].tobytes() == begun["task"].tobytes()
    kept = first.copy(), second.copy()
    walk(env, 5)
    np.testing.assert_array_equal((first, second), kept)


@pytest.mark.parametrize("engine", ["compiled", "pymunk"])
@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_can_be_played_or_is_refused(monkeypatch, engine, copied):
    """A world in an episode cannot be copied; before and after one there is none."""
    monkeypatch.setattr("tma_ray.physics.selection.engine_in_use", lambda: EngineChoice(engine, "chosen"))
    env = make_environment("stump_tracks")
    first = copied(env)
    walk(env, 5)
    with pytest.raises(TypeError, match=r"in an episode cannot be copied or pickled.*copy it before reset"):
        copied(env)
    env.max_episode_steps = 1
    env.reset(seed=1)
    env.step(np.zeros(env.action_space.shape, np.float32))
    for other in (first, copied(env)):
        np.testing.assert_array_equal(other.reset(seed=2)[0], env.reset(seed=2)[0])
        action = env.action_space.sample()
        np.testing.assert_array_equal(other.step(action)[0], env.step(action)[0])


@every_one
def test_it_draws_its_world_which_changes_nothing(name: str, body: str) -> None:
    plain, drawn = (make_environment(name, embodiment=body, render_mode=mode) for mode in (None, "rgb_array"))
    drawn.reset(seed=0)
    frame = drawn.render()
    assert (frame.shape, frame.dtype) == ((400, 600, 3), np.uint8)
    colours = frame.astype(np.uint32) @ np.array([2**16, 2**8, 1], np.uint32)
    assert len(np.unique(colours)) > 20
    seen = [[row[0] for row in walk(env, 10, draw=env is drawn)] for env in (plain, drawn)]
    np.testing.assert_array_equal(*seen)
    assert not np.array_equal(drawn.render(), frame)
    drawn.close()
