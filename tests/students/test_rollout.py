"""PPO's rollout and normaliser, bit for bit as in stable-baselines3, and in closed form."""

import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize
from students_support import Drift

from tma_ray.students.normaliser import Normaliser
from tma_ray.students.rollout_workers.ppo import Rollout


def filled(steps: int, ended, judged, rewards=None) -> Rollout:
    rng = np.random.default_rng(0)
    rollout = Rollout(steps, 3, 2, np.random.default_rng(7), torch.device("cpu"))
    for index in range(steps):
        reward = rng.normal() if rewards is None else rewards[index]
        rollout.add(rng.normal(size=3), rng.normal(size=2), reward, bool(ended[index]), judged[index])
    return rollout


@pytest.mark.parametrize("last_ended", [False, True])
def test_returns_and_advantages_equal_stable_baselines3_to_the_last_bit(last_ended):
    steps = 200
    ended = np.random.default_rng(1).random(steps) < 0.1
    ended[-1] = last_ended
    values, log_probabilities = np.random.default_rng(2).normal(size=(2, steps)).astype(np.float32)
    ours = filled(steps, ended, list(zip(values, log_probabilities, strict=True)))
    box = spaces.Box(-1, 1, (3,)), spaces.Box(-1, 1, (2,))
    stock = RolloutBuffer(steps, *box, device="cpu", gae_lambda=0.95, gamma=0.99)
    for index in range(steps):
        start = np.array([index == 0 or ended[index - 1]])
        value, probability = (torch.tensor([column[index]]) for column in (values, log_probabilities))
        seen = (each[None, index] for each in (ours.observations, ours.actions, ours.rewards))
        stock.add(*seen, start, value, probability)
    stock.compute_returns_and_advantage(torch.tensor([[0.3]]), dones=np.array([last_ended]))
    ours.finish(0.3, gamma=0.99, gae_lambda=0.95)
    np.testing.assert_array_equal(ours.advantages, stock.advantages[:, 0])
    np.testing.assert_array_equal(ours.returns, stock.returns[:, 0])


def test_lambda_one_gives_discounted_returns_and_lambda_zero_one_step_errors():
    ended, judged = [False, True, False, False], [(value, 0.0) for value in (5, 6, 7, 8)]
    rollout = filled(4, ended, judged, rewards=[1.0, 2.0, 4.0, 8.0])
    rollout.finish(last_value=16.0, gamma=0.5, gae_lambda=1.0)
    np.testing.assert_allclose(rollout.returns, [1 + 0.5 * 2, 2, 4 + 0.5 * (8 + 0.5 * 16), 8 + 0.5 * 16])
    rollout.finish(last_value=16.0, gamma=0.5, gae_lambda=0.0)
    np.testing.assert_allclose(rollout.advantages, [1 + 3 - 5, 2 - 6, 4 + 4 - 7, 8 + 8 - 8])


def test_equals_vec_normalize_to_the_last_bit():
    stock = VecNormalize(DummyVecEnv([lambda: Drift(seed=5)]), gamma=0.9, clip_obs=1.5, clip_reward=0.8)
    ours, env = Normaliser(3, 0.9, 1.5, 0.8), Drift(seed=5)
    rng = np.random.default_rng(0)
    observation = env.reset()[0]
    ours.update(observation)
    np.testing.assert_array_equal(ours.normalise(observation), stock.reset()[0])
    for _ in range(300):
        action = rng.uniform(env.action_space.low, env.action_space.high).astype(np.float32)
        observation, reward, terminated, truncated, _ = env.step(action)
        ours.update_reward(float(np.float32(reward)))  # a DummyVecEnv rounds rewards to float32
        if terminated or truncated:
            observation = env.reset()[0]
        ours.update(observation)
        their_observations, their_rewards, dones, _ = stock.step(action[None])
        assert dones[0] == (terminated or truncated)
        np.testing.assert_array_equal(ours.normalise(observation), their_observations[0])
        assert np.float32(ours.normalise_reward(float(np.float32(reward)))) == their_rewards[0]
        if dones[0]:
            ours.end_episode()
    assert ours.reward_scale == np.sqrt(stock.ret_rms.var + 1e-8)


def test_statistics_are_those_of_the_stream_and_normalising_changes_nothing():
    rng = np.random.default_rng(0)
    observations = rng.normal([1, -2, 30], [1, 0.1, 5], size=(5000, 3)).astype(np.float32)
    ours, before = Normaliser(3, 0.99, 10, 10), observations.copy()
    for observation in observations:
        ours.update(observation)
    normalised = ours.normalise(observations)
    np.testing.assert_allclose(normalised.mean(axis=0), 0, atol=1e-3)
    np.testing.assert_allclose(normalised.std(axis=0), 1, atol=1e-3)
    np.testing.assert_array_equal(ours.normalise(observations), normalised)
    np.testing.assert_array_equal(observations, before)
