import numpy as np
import pytest
import torch
from students_support import Drift, small_student, train

OBSERVATIONS = np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32)


@pytest.fixture(params=["ppo", "sac"])
def trained(request):
    student = small_student(request.param)
    train(student, Drift(), 130)
    student.kind = request.param
    return student


def seen_by_the_model(student) -> np.ndarray:
    return student.normaliser.normalise(OBSERVATIONS) if student.kind == "ppo" else OBSERVATIONS


def test_greedy_actions_equal_stable_baselines3(trained):
    expected = trained.model.predict(seen_by_the_model(trained), deterministic=True)[0]
    actions = trained.act_greedily(OBSERVATIONS)
    assert actions.dtype == np.float32
    np.testing.assert_allclose(actions, expected, atol=1e-6)
    assert np.ptp(actions, axis=0).min() > 1e-3  # it does look at the observations


@pytest.mark.parametrize("name", ["ppo", "sac", "stock:ppo", "stock:sac"])
def test_acting_never_lags_behind_the_policy(name, tmp_path):
    """After updates, resets and loads, one observation's actions are those of the model."""
    student = small_student(name)
    student.kind = name.removeprefix("stock:")

    def gap() -> float:
        expected = student.model.predict(seen_by_the_model(student), deterministic=True)[0]
        actions = np.concatenate([student.act_greedily(row[None]) for row in OBSERVATIONS])
        return np.abs(actions - expected).max()

    def exploring() -> np.ndarray:
        """The mean of exploring actions, without the noise."""
        student._noise = lambda: np.zeros(2, np.float32)
        student._episode_starts = False
        actions = np.array([student.act(row) for row in OBSERVATIONS])
        del student._noise
        return actions

    train(student, Drift(), 70)  # past the uniform actions of SAC
    changes = (
        lambda: train(student, Drift(), 60),
        student.reset,
        lambda: train(student, Drift(), 60),
        lambda: student.load(tmp_path),
    )
    student.save(tmp_path)
    for change in changes:
        before = student.act_greedily(OBSERVATIONS)
        change()
        assert gap() < 1e-5
        np.testing.assert_allclose(exploring(), student.act_greedily(OBSERVATIONS), atol=1e-5)
        assert np.abs(student.act_greedily(OBSERVATIONS) - before).max() > 1e-3


def test_exploring_adds_the_deviation_times_the_noise():
    student = small_student("ppo")
    with torch.no_grad():
        student.model.policy.log_std.copy_(torch.tensor([-1.0, -2.0]))
    student._refresh()
    noise = np.array([0.1, -0.2], np.float32)
    student._noise = lambda: noise
    student.act(OBSERVATIONS[0])
    mean = student.model.predict(student.normaliser.normalise(OBSERVATIONS[:1]), deterministic=True)[0][0]
    expected = mean + np.exp([-1, -2]) * [0.1, -0.2]
    np.testing.assert_allclose(student._step.sampled, expected, atol=1e-6)


def test_ppo_plays_clipped_actions_and_learns_from_them_as_sampled():
    student = small_student("ppo")
    transitions = train(student, Drift(), 70)
    sampled = student.rollout.state()["actions"]
    played = np.array([t.action for t in transitions[50:]])
    np.testing.assert_array_equal(
        np.clip(sampled, student.action_space.low, student.action_space.high), played
    )
    assert (sampled != played).any()


@pytest.mark.parametrize("name", ["ppo", "sac"])
def test_exploring_actions_follow_the_policys_distribution(name):
    student = small_student(name, exploration_steps=0) if name == "sac" else small_student(name)
    observation = OBSERVATIONS[0]
    if name == "ppo":
        student._episode_starts = False  # so that the observation normalises alike each time
    actions = np.array([student.act(observation) for _ in range(4000)])
    seen = torch.from_numpy(observation[None]).repeat(4000, 1)
    if name == "ppo":
        seen = torch.from_numpy(student.normaliser.normalise(seen.numpy()))
    with torch.random.fork_rng():
        torch.manual_seed(0)
        expected = student.model.predict(seen.numpy(), deterministic=False)[0]
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
    from gymnasium import spaces

    from tma_ray.students import make_student

    boxes = spaces.Box(-1, 1, (24,)), spaces.Box(-1, 1, (4,))
    student = make_student("ppo", *boxes, np.random.SeedSequence(0))
    trunk, policy, value = 24 * 400 + 400 + 400 * 300 + 300, 300 * 4 + 4 + 4, 300 + 1
    count = sum(parameter.numel() for parameter in student.model.policy.parameters())
    assert count == trunk + policy + value


def test_steps_of_ppo_carry_value_and_log_probability_of_the_policy():
    student = small_student("ppo")
    train(student, Drift(), 130)
    for observation in OBSERVATIONS:
        student.act(observation)
        step = student._step
        seen, action = torch.from_numpy(step.observation[None]), torch.from_numpy(step.sampled[None])
        with torch.no_grad():
            value, log_probability, _ = student.model.policy.evaluate_actions(seen, action)
        np.testing.assert_allclose(step.judged, (value.item(), log_probability.item()), atol=1e-5)
