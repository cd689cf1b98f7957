"""Environments stepped together play the same episodes as one by one."""

import gymnasium
import numpy as np
import pytest

from tma_ray.envs import ENVIRONMENTS, make_environment
from tma_ray.envs.vector import EngineLockStep, LockStep, lock_step

COUNT = 5


@pytest.fixture(params=ENVIRONMENTS.names())
def environments(request):
    return [make_environment(request.param) for _ in range(COUNT)]


def play(worlds, tasks: np.ndarray, steps: int) -> list[tuple[bytes, list[float], list[bool]]]:
    """Play random episodes, twice, and return all that is seen."""
    seen = []
    for episode in range(2):
        rng = np.random.default_rng(episode)
        observations, played = worlds.reset(np.arange(COUNT), list(range(COUNT)), tasks)
        assert played.tolist() == tasks.tolist()
        running = np.arange(COUNT)
        for _ in range(steps):
            actions = rng.uniform(-1, 1, (COUNT, 4)).astype(np.float32)[running]
            seen.append((observations.tobytes(),))
            outcome = worlds.step(running, actions)
            seen.append(tuple(column.tobytes() for column in outcome))
            running, observations = running[~outcome.over], outcome.observations[~outcome.over]
            if not len(running):
                break
    return seen


def test_together_equals_one_by_one(environments) -> None:
    tasks = environments[0].task_space.sample(np.random.default_rng(0), COUNT)
    steps = environments[0].max_episode_steps + 1
    fast, plain = lock_step(environments), LockStep(environments)
    assert isinstance(fast, EngineLockStep)
    seen = play(fast, tasks, steps)
    assert seen == play(plain, tasks, steps)
    assert len(seen) > 200


def test_an_environment_of_somebody_else_is_stepped_one_by_one() -> None:
    made = [gymnasium.make("Pendulum-v1") for _ in range(2)]
    assert type(lock_step(made)) is LockStep


def test_who_handed_its_engine_over_is_reset_before_its_next_step(environments) -> None:
    environment = environments[0]
    with pytest.raises(gymnasium.error.ResetNeeded):
        environment.release_engine()
    environment.reset(seed=0)
    environment.release_engine()
    with pytest.raises(gymnasium.error.ResetNeeded):
        environment.step(np.zeros(4))
    environment.reset(seed=0)
    environment.step(np.zeros(4))
