import numpy as np
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize
from students_support import Drift

from tma_ray.students.normaliser import Normaliser


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


def test_statistics_are_those_of_the_stream():
    rng = np.random.default_rng(0)
    observations = rng.normal([1, -2, 30], [1, 0.1, 5], size=(5000, 3)).astype(np.float32)
    ours = Normaliser(3, 0.99, 10, 10)
    for observation in observations:
        ours.update(observation)
    normalised = ours.normalise(observations)
    np.testing.assert_allclose(normalised.mean(axis=0), 0, atol=1e-3)
    np.testing.assert_allclose(normalised.std(axis=0), 1, atol=1e-3)


def test_normalising_changes_nothing():
    ours = Normaliser(3, 0.99, 10, 10)
    ours.update(np.ones(3, np.float32))
    observations = np.full((4, 3), 2, np.float32)
    first = ours.normalise(observations)
    np.testing.assert_array_equal(ours.normalise(observations), first)
    assert (observations == 2).all()


def test_survives_its_file_to_the_last_bit(tmp_path):
    ours, rng = Normaliser(3, 0.97, 9, 8), np.random.default_rng(1)
    for _ in range(50):
        ours.update(rng.normal(size=3).astype(np.float32))
        ours.update_reward(rng.normal())
    ours.save(tmp_path / "normaliser.json")
    loaded = Normaliser.load(tmp_path / "normaliser.json")
    for _ in range(50):
        observation, reward = rng.normal(size=3).astype(np.float32), rng.normal()
        for normaliser in (ours, loaded):
            normaliser.update(observation)
            normaliser.update_reward(reward)
        np.testing.assert_array_equal(ours.normalise(observation), loaded.normalise(observation))
        assert ours.normalise_reward(reward) == loaded.normalise_reward(reward)
