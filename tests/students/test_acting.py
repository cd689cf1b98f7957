import numpy as np
import pytest
import torch
from gymnasium import spaces
from students_support import Drift, small_student, train

from tma_ray.students import make_student

OBSERVATIONS = np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32)


def normalised(student, observations: np.ndarray) -> np.ndarray:
    """Return what the model of a student sees."""
    return student.normaliser.normalise(observations) if hasattr(student, "normaliser") else observations


@pytest.mark.parametrize("name", ["ppo", "sac", "stock:ppo", "stock:sac"])
def test_acting_never_lags_behind_the_policy(name, tmp_path):
    """After updates, resets and loads, actions are those of the model, one by one and together."""
    student = small_student(name)

    def gap() -> float:
        expected = student.model.predict(normalised(student, OBSERVATIONS), deterministic=True)[0]
        one_by_one = np.concatenate([student.act_greedily(row[None]) for row in OBSERVATIONS])
        together = student.act_greedily(OBSERVATIONS)
        assert together.dtype == np.float32
        return np.abs([one_by_one - expected, together - expected]).max()

    def exploring() -> np.ndarray:
        """The mean of exploring actions, without the noise."""
        student._noise = lambda: np.zeros(2, np.float32)
        student._episode_starts = False
        actions = np.array([student.act(row) for row in OBSERVATIONS])
        del student._noise
        return actions

    train(student, Drift(), 70)  # past the uniform actions of SAC
    learn = lambda: train(student, Drift(), 60)  # noqa: E731
    changes = (learn, student.reset, learn, lambda: student.load(tmp_path))
    student.save(tmp_path)
    for change in changes:
        before = student.act_greedily(OBSERVATIONS)
        change()
        assert gap() < 1e-5
        assert np.ptp(student.act_greedily(OBSERVATIONS), axis=0).min() > 1e-3  # they look at observations
        np.testing.assert_allclose(exploring(), student.act_greedily(OBSERVATIONS), atol=1e-5)
        assert np.abs(student.act_greedily(OBSERVATIONS) - before).max() > 1e-3


@pytest.mark.parametrize("name", ["ppo", "sac"])
def test_exploring_actions_follow_the_policys_distribution(name):
    student = small_student(name, exploration_steps=0) if name == "sac" else small_student(name)
    student._episode_starts = False  # so that PPO normalises the observation alike each time
    actions = np.array([student.act(OBSERVATIONS[0]) for _ in range(4000)])
    with torch.random.fork_rng():
        torch.manual_seed(0)
        seen = normalised(student, OBSERVATIONS[:1].repeat(4000, axis=0))
        expected = student.model.predict(seen, deterministic=False)[0]
    for share in (10, 30, 50, 70, 90):
        quantiles = [np.percentile(sample, share, axis=0) for sample in (actions, expected)]
        np.testing.assert_allclose(*quantiles, atol=0.15)


def test_the_first_actions_of_sac_are_uniform():
    student = small_student("sac", exploration_steps=3000)
    low, high = student.action_space.low, student.action_space.high
    actions = np.array([student.act(OBSERVATIONS[0]) for _ in range(3000)])
    shares = (actions - low) / (high - low)
    for share in (0.1, 0.5, 0.9):
        np.testing.assert_allclose(np.quantile(shares, share, axis=0), share, atol=0.05)


def test_policy_and_value_of_ppo_share_the_papers_trunk():
    boxes = spaces.Box(-1, 1, (24,)), spaces.Box(-1, 1, (4,))
    student = make_student("ppo", *boxes, np.random.SeedSequence(0))
    trunk, policy, value = 24 * 400 + 400 + 400 * 300 + 300, 300 * 4 + 4 + 4, 300 + 1
    count = sum(parameter.numel() for parameter in student.model.policy.parameters())
    assert count == trunk + policy + value
