"""Stump Tracks as its users meet it."""

import gymnasium
import numpy as np
import pytest

import tma_ray.envs
from tma_ray.embodiments import load_embodiment
from tma_ray.envs.stump_tracks import StumpTracks
from tma_ray.tasks import MASTERY_RETURN

EASY = {"task": [0.0, 6.0]}


class ScriptedEngine:
    """Gives the rewards it is told, and ends the episode with the last if told so."""

    def __init__(self, rewards: list[float], ends: bool = False) -> None:
        self.rewards, self.ends = list(rewards), ends
        self.observation = np.zeros(24, dtype=np.float32)

    def reset(self, terrain, push) -> np.ndarray:
        return self.observation

    def step(self, action) -> tuple[np.ndarray, float, bool]:
        reward = self.rewards.pop(0)
        return self.observation, reward, self.ends and not self.rewards


def scripted(rewards: list[float], ends: bool = False) -> StumpTracks:
    env = StumpTracks()
    env._engine = ScriptedEngine(rewards, ends)
    env.reset(seed=0, options=EASY)
    return env


def test_spaces() -> None:
    env = StumpTracks(embodiment=load_embodiment("classic_bipedal"))
    assert env.action_space == gymnasium.spaces.Box(-1, 1, (4,), np.float32)
    assert env.observation_space.shape == (24,)
    assert env.observation_space.dtype == np.float32
    assert env.task_space.names == env.valid_domain.names == ("stump_height", "obstacle_spacing")
    assert env.valid_domain.low.tolist() == [-3, 0]
    assert env.valid_domain.high.tolist() == [9, 6]


def test_an_episode_is_truncated_after_2000_steps_and_only_then() -> None:
    env = StumpTracks()
    for seed in range(20):
        env.reset(seed=seed, options=EASY)
        rng, length, terminated, truncated = np.random.default_rng(seed), 0, False, False
        while not (terminated or truncated):
            _, _, terminated, truncated, _ = env.step(rng.uniform(-1, 1, 4))
            length += 1
        assert truncated == (length == 2000)
        assert terminated == (length < 2000)
        if truncated:
            return
    pytest.fail("no walker stayed up for 2000 steps: nothing was tested")


def test_an_end_at_the_last_step_is_a_termination_not_a_truncation() -> None:
    env = scripted([0.0] * 2000, ends=True)
    *before, last = [env.step(np.zeros(4)) for _ in range(2000)]
    assert last[2:4] == (True, False)
    assert last[4]["is_success"] is False
    assert all(step[4].keys() == {"success", "task"} for step in before)


def test_a_task_may_be_given_by_names() -> None:
    env = gymnasium.make("tma_ray/StumpTracks-v0")
    assert env.spec.reward_threshold == MASTERY_RETURN
    task = {"obstacle_spacing": 3.0, "stump_height": 1.0}
    assert env.reset(seed=1, options={"task": task})[1]["task"].tolist() == [1.0, 3.0]
    with pytest.raises(ValueError, match=r"the names \['height'\]: expected exactly stump_height, obstacle"):
        env.reset(options={"task": {"height": 1.0}})


@pytest.mark.parametrize(("extra", "success"), [(0.0, False), (0.01, True), (-0.01, False)])
def test_success_is_a_return_strictly_over_the_mastery_threshold(extra: float, success: bool) -> None:
    env = scripted([MASTERY_RETURN, extra])
    assert [env.step(np.zeros(4))[4]["success"] for _ in range(2)] == [False, success]


def test_success_is_of_this_episode_only() -> None:
    env = scripted([MASTERY_RETURN + 1, 0.0])
    assert env.step(np.zeros(4))[4]["success"]
    assert env.reset(options=EASY)[1]["success"] is False
    assert not env.step(np.zeros(4))[4]["success"]


def test_a_fall_costs_100_and_ends_the_episode() -> None:
    env = StumpTracks()
    env.reset(seed=0, options=EASY)
    steps = [env.step(np.zeros(4))]
    while not steps[-1][2]:
        steps.append(env.step(np.zeros(4)))
    assert steps[-1][1] == -100
    assert all(reward > -100 for _, reward, *_ in steps[:-1])
    with pytest.raises(gymnasium.error.ResetNeeded, match="call reset"):
        env.step(np.zeros(4))


def test_stepping_before_reset_is_refused() -> None:
    with pytest.raises(gymnasium.error.ResetNeeded, match="not begun"):
        StumpTracks().step(np.zeros(4))


def test_the_task_builds_the_world() -> None:
    env = StumpTracks(render_mode="rgb_array")
    lidars = {}
    for height in (0.0, 3.0, 9.0):
        observation, info = env.reset(seed=0, options={"task": [height, 6.0]})
        assert info["task"].tolist() == [height, 6.0]
        lidars[height] = observation[-1]
    assert lidars[9.0] < lidars[0.0] == 1.0


def test_without_a_task_it_draws_uniform_ones_from_the_task_space() -> None:
    env = StumpTracks()
    tasks = np.array([env.reset(seed=0 if i == 0 else None)[1]["task"] for i in range(150)])
    assert tasks.min(axis=0) == pytest.approx([0, 0], abs=0.3)
    assert tasks.max(axis=0) == pytest.approx([3, 6], abs=0.3)
    assert env.task_space.contains(tasks)


def test_every_episode_of_a_seed_is_its_own() -> None:
    env = StumpTracks()
    first = env.reset(seed=0, options={"task": [3.0, 0.0]})[0]
    second = env.reset(options={"task": [3.0, 0.0]})[0]
    assert not np.array_equal(first, second)
    np.testing.assert_array_equal(env.reset(seed=0, options={"task": [3.0, 0.0]})[0], first)


def test_what_declares_no_tasks_is_refused() -> None:
    with pytest.raises(ValueError, match="task_space"):
        tma_ray.envs.make_environment("gymnasium.envs.classic_control:CartPoleEnv")


def test_the_window_opens_and_closes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = StumpTracks(render_mode="human")
    env.reset(seed=0, options=EASY)
    assert env.step(np.zeros(4))[0].shape == (24,)
    env.close()
    env.close()
