"""Checkpoints, isolation, forgetting and state values."""

import json
import random
from pathlib import Path

import numpy as np
import pytest
import torch
from students_support import (
    OURS,
    SMALL,
    Drift,
    differ,
    digest,
    parameters,
    small_student,
    train,
    train_episodes,
)
from suite.processes import python

from tma_ray.students import load_policy

OBSERVATIONS = np.random.default_rng(0).normal(size=(20, 3)).astype(np.float32)
NAMES = pytest.mark.parametrize("name", OURS)


@pytest.mark.slow
def test_a_new_process_goes_on_bit_for_bit(tmp_path):
    expected, calls = [], []
    for name in OURS:
        student = small_student(name)
        train_episodes(student, range(20))
        first, second = (tmp_path / name / step for step in ("first", "second"))
        digest(student, first)
        returns = train_episodes(student, range(20, 40))
        # the buffer of SAC has wrapped by then, and PPO stopped within a rollout
        expected.append([returns, digest(student, tmp_path / name / "straight")])
        calls.append(f"resume({name!r}, {str(first)!r}, range(20, 40), {str(second)!r})")
    script = (
        f"import json, sys; sys.path.insert(0, {str(Path(__file__).parent)!r});"
        f"from students_support import resume;"
        f"print(json.dumps([{', '.join(calls)}]))"
    )
    assert json.loads(python("-c", script)) == expected


@NAMES
def test_saving_playing_greedily_and_asking_for_values_change_nothing(name, tmp_path):
    saver, other = small_student(name), small_student(name)
    for start in (0, 10):
        digest(saver, tmp_path / f"during-{start}")
        (tmp_path / f"again-{start}").mkdir()
        saver.save(tmp_path / f"again-{start}", incremental=True)
        saver.save_policy(tmp_path)
        saver.act_greedily(OBSERVATIONS)
        saver.state_values(OBSERVATIONS)
        returns = [train_episodes(student, range(start, start + 10)) for student in (saver, other)]
        assert returns[0] == returns[1]


@pytest.mark.parametrize(
    ("saved", "name", "values", "message"),
    [
        ("ppo", "ppo", {"gamma": 0.5}, r"gamma 0\.99, here 0\.5"),
        ("sac", "sac", {"gamma": 0.5}, r"gamma 0\.99, here 0\.5"),
        ("sac", "ppo", {}, "buffer_size 150, here none"),
    ],
)
def test_a_state_of_another_student_is_refused(saved, name, values, message, tmp_path):
    small_student(saved).save(tmp_path)
    with pytest.raises(ValueError, match=message):
        small_student(name, **values).load(tmp_path)


def test_interleaved_students_do_not_perturb_each_other_and_another_seed_is_another(tmp_path):
    def trained(name, seed=0):
        student = small_student(name, seed)
        train_episodes(student, range(20))
        return digest(student, tmp_path / f"{name}-{seed}")

    alone = {name: trained(name) for name in OURS}
    together = {name: small_student(name) for name in OURS}
    for episode in range(20):
        for student in together.values():
            train_episodes(student, range(episode, episode + 1))
            torch.randn(3), np.random.rand(3)  # noqa: NPY002  # what a teacher may do
    for name, student in together.items():
        assert digest(student, tmp_path / name) == alone[name]
        assert trained(name, seed=1)["networks.pt"] != alone[name]["networks.pt"]


@pytest.mark.parametrize("name", SMALL)
def test_it_learns_goes_on_from_its_files_and_leaves_the_global_generators(name, tmp_path):
    def states():
        legacy = np.random.get_state()  # noqa: NPY002
        return torch.get_rng_state().tolist(), legacy[1].tolist(), legacy[2:], random.getstate()

    before = states()
    first, second = small_student(name), small_student(name, seed=9)
    initial = parameters(first)
    train_episodes(first, range(8))
    assert differ(initial, parameters(first))
    digest(first, tmp_path / "first")
    second.load(tmp_path / "first")
    assert train_episodes(first, range(8, 14)) == train_episodes(second, range(8, 14))
    assert digest(first, tmp_path / "a") == digest(second, tmp_path / "b")
    values = first.state_values(OBSERVATIONS)
    assert (values.shape, values.dtype) == ((20,), np.float64)
    assert np.isfinite(values).all()
    first.save_policy(tmp_path)
    assert {act(OBSERVATIONS).shape for act in (load_policy(name, tmp_path), first.act_greedily)} == {(20, 2)}
    first.reset()
    train(first, Drift(), 80)
    assert states() == before


@NAMES
def test_a_reset_forgets_all_but_the_statistics_that_normalise(name, tmp_path):
    student = small_student(name)
    train(student, Drift(), 130)
    trained = parameters(student)
    normalised = student.normaliser.normalise(OBSERVATIONS) if name == "ppo" else None
    student.reset()
    fresh = parameters(student)
    assert differ(trained, fresh)
    state = student.model.get_parameters()
    assert all(not state[key]["state"] for key in state if key.endswith("optimizer"))
    assert not student.model.logger.name_to_value
    if name == "sac":
        assert len(student.replay) == 0
        for key in fresh:
            if key.startswith("critic_target"):
                assert (fresh[key] == fresh[key.replace("critic_target", "critic")]).all()
    else:
        assert len(student.rollout.state()["rewards"]) == 0
        np.testing.assert_array_equal(student.normaliser.normalise(OBSERVATIONS), normalised)
    train(student, Drift(), 130)  # and goes on
    assert differ(fresh, parameters(student))


def test_a_reset_does_not_repeat_the_uniform_exploration():
    student = small_student("sac")
    train(student, Drift(), 60)
    student.reset()
    # a fresh policy spreads little around its mean; uniform actions would reach all corners
    mean = student.act_greedily(OBSERVATIONS[:1])[0]
    with torch.no_grad():
        log_std = student.model.actor.get_action_dist_params(torch.from_numpy(OBSERVATIONS[:1]))[1]
    student._refresh()
    assert (log_std + 9).abs().max() < 5
    student._refresh()
    np.testing.assert_allclose(student.act(OBSERVATIONS[0]), mean, atol=0.1)
    train(student, Drift(limit=10, ending=0.0), 20)
    assert student.model._n_updates == 2  # updates go on at once


def test_ppo_values_are_those_of_the_value_head_in_raw_rewards():
    student = small_student("ppo")
    train(student, Drift(), 130)
    seen = torch.from_numpy(student.normaliser.normalise(OBSERVATIONS))
    with torch.no_grad():
        expected = student.model.policy.predict_values(seen)[:, 0].numpy() * student.normaliser.reward_scale
    np.testing.assert_allclose(student.state_values(OBSERVATIONS), expected, rtol=1e-5)
    assert student.normaliser.reward_scale > 2


def test_sac_values_are_the_expected_soft_values():
    student = small_student("sac", value_samples=4000, entropy_coefficient=0.7)
    train(student, Drift(), 130)
    model, observations = student.model, 10 * OBSERVATIONS[:4]
    repeated = torch.from_numpy(observations).repeat_interleave(8_000, dim=0)
    torch.manual_seed(0)
    with torch.no_grad():
        actions, log_probabilities = model.actor.action_log_prob(repeated)
        smallest = torch.cat(model.critic(repeated, actions), dim=1).min(dim=1).values
        expected = (smallest - 0.7 * log_probabilities).reshape(4, -1).mean(dim=1).numpy()
    np.testing.assert_allclose(student.state_values(observations), expected, atol=0.06)
    assert np.ptp(expected) > 0.3


@pytest.mark.parametrize("log_std", ["clamp", "tanh"])
@pytest.mark.parametrize("name", ["sac", "stock:sac"])
def test_entropy_bonuses_are_the_expected_log_probabilities(name, log_std):
    student = small_student(name, log_std=log_std, entropy_coefficient=0.7)
    with torch.no_grad():
        student.model.actor.log_std.bias += torch.linspace(-1, 1, len(student.model.actor.log_std.bias))
        repeated = torch.from_numpy(OBSERVATIONS[:4]).repeat_interleave(20_000, dim=0)
        torch.manual_seed(0)
        expected = -0.7 * student.model.actor.action_log_prob(repeated)[1].reshape(4, -1).mean(dim=1).numpy()
    np.testing.assert_allclose(student.entropy_bonuses(OBSERVATIONS[:4]), expected, atol=0.05)
    assert not small_student("ppo").entropy_bonuses(OBSERVATIONS).any()


def test_sac_values_of_a_policy_without_spread_are_in_closed_form():
    student = small_student("sac", value_samples=2000, entropy_coefficient=0.0, log_std="clamp")
    with torch.no_grad():
        student.model.actor.log_std.weight.zero_()
        student.model.actor.log_std.bias.fill_(-15)
    seen = torch.from_numpy(OBSERVATIONS)
    with torch.no_grad():
        values = student.model.critic(seen, student.model.actor(seen, deterministic=True))
        expected = torch.cat(values, dim=1).min(dim=1).values.numpy()
    np.testing.assert_allclose(student.state_values(OBSERVATIONS), expected, atol=1e-5)


def test_evaluations_see_the_exponential_average_of_the_weights(tmp_path):
    student = small_student("ppo", averaged_steps=120)
    share = 1 - np.exp(-50 / 120)
    average, env = flat(student), Drift()
    for _ in range(3):
        train(student, env, 50)
        average = (1 - share) * average + share * flat(student)
    np.testing.assert_allclose(student.average, average, rtol=1e-5, atol=1e-7)
    assert np.abs(flat(student) - average).max() > 1e-4
    present = student.act_greedily(OBSERVATIONS)
    student.put_average(flat(student))
    assert np.abs(student.act_greedily(OBSERVATIONS) - present).max() > 1e-5
    student.save(tmp_path)
    other = small_student("ppo", averaged_steps=120)
    other.load(tmp_path)
    np.testing.assert_array_equal(other.act_greedily(OBSERVATIONS), student.act_greedily(OBSERVATIONS))
    student.reset()
    np.testing.assert_array_equal(student.average, flat(student))


def flat(student) -> np.ndarray:
    """Return the parameters of the network (p,)."""
    return student._network.parameters.detach().numpy().copy()


@pytest.mark.parametrize("name", [*SMALL, "stock:ppo", "stock:sac"])
def test_torchs_default_type_changes_nothing(name, tmp_path):
    """A plug-in of the same process may set it, and keeps what it has set."""
    found, outside = [], torch.get_default_dtype()
    for dtype in (torch.float32, torch.float64):
        torch.set_default_dtype(dtype)
        try:
            student = small_student(name)
            train(student, Drift(), 130)
            student.reset()
            train(student, Drift(), 30)
            student.save_policy(tmp_path)
            policy = load_policy(name, tmp_path)
            layers = student.policy_layers(tmp_path)(torch.from_numpy(OBSERVATIONS)).detach().numpy()
            found.append([student.act_greedily(OBSERVATIONS), policy(OBSERVATIONS), layers])
            found[-1] += [student.state_values(OBSERVATIONS), student.entropy_bonuses(OBSERVATIONS)]
            assert torch.get_default_dtype() == dtype
        finally:
            torch.set_default_dtype(outside)
    for single, double in zip(*found, strict=True):
        assert single.dtype == double.dtype
        np.testing.assert_array_equal(single, double)
