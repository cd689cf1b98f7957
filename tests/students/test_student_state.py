"""Checkpoints, isolation, forgetting and state values."""

import json
import random
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from students_support import Drift, digest, parameters, small_student, train, train_episodes

from tma_ray.students import load_policy

OBSERVATIONS = np.random.default_rng(0).normal(size=(20, 3)).astype(np.float32)
NAMES = pytest.mark.parametrize("name", ["ppo", "sac"])


@pytest.mark.slow
def test_a_new_process_goes_on_bit_for_bit(tmp_path):
    expected, calls = [], []
    for name in ("ppo", "sac"):
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
    run = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True)
    assert json.loads(run.stdout) == expected


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


@NAMES
def test_a_state_of_other_hyperparameters_is_refused(name, tmp_path):
    small_student(name).save(tmp_path)
    with pytest.raises(ValueError, match=r"gamma 0\.99, here 0\.5"):
        small_student(name, gamma=0.5).load(tmp_path)


def test_a_state_of_another_algorithm_is_refused(tmp_path):
    small_student("sac").save(tmp_path)
    with pytest.raises(ValueError, match="buffer_size 150, here none"):
        small_student("ppo").load(tmp_path)


@NAMES
def test_the_same_seed_gives_the_same_student_and_another_seed_another(name, tmp_path):
    seed = np.random.SeedSequence(5)
    students = [small_student(name, seed=s) for s in (0, 0, 1)]
    for student in students:
        train_episodes(student, range(10))
    first, same, other = (digest(s, tmp_path / str(i)) for i, s in enumerate(students))
    assert first == same
    assert first["networks.pt"] != other["networks.pt"]
    assert seed.n_children_spawned == 0


def test_interleaved_students_do_not_perturb_each_other(tmp_path):
    alone = {}
    for name in ("ppo", "sac"):
        student = small_student(name)
        train_episodes(student, range(20))
        alone[name] = digest(student, tmp_path / f"alone-{name}")
    together = {name: small_student(name) for name in ("ppo", "sac")}
    for episode in range(20):
        for student in together.values():
            train_episodes(student, range(episode, episode + 1))
            torch.randn(3), np.random.rand(3)  # noqa: NPY002  # what a teacher may do
    for name, student in together.items():
        assert digest(student, tmp_path / f"together-{name}") == alone[name]


@NAMES
def test_the_global_generators_stay_as_they_were(name, tmp_path):
    def states():
        legacy = np.random.get_state()  # noqa: NPY002
        return torch.get_rng_state().tolist(), legacy[1].tolist(), legacy[2:], random.getstate()

    before = states()
    student = small_student(name)
    train(student, Drift(), 130)
    student.state_values(OBSERVATIONS)
    student.save(tmp_path)
    student.save_policy(tmp_path)
    student.load(tmp_path)
    load_policy(name, tmp_path)(OBSERVATIONS)
    student.reset()
    assert states() == before


@NAMES
def test_a_reset_forgets_networks_optimisers_and_experience(name, tmp_path):
    student = small_student(name)
    train(student, Drift(), 130)
    trained = parameters(student)
    student.reset()
    fresh = parameters(student)
    assert any((trained[key] != fresh[key]).any() for key in trained)
    state = student.model.get_parameters()
    assert all(not state[key]["state"] for key in state if key.endswith("optimizer"))
    assert student.scalars() == {}
    if name == "sac":
        assert len(student.replay) == 0
        for key in fresh:
            if key.startswith("critic_target"):
                assert (fresh[key] == fresh[key.replace("critic_target", "critic")]).all()
    else:
        assert len(student.rollout.state()["rewards"]) == 0
    train(student, Drift(), 130)  # and goes on
    assert any((fresh[key] != value).any() for key, value in parameters(student).items())


def test_a_reset_keeps_the_statistics_that_normalise():
    student = small_student("ppo")
    train(student, Drift(), 130)
    before = student.normaliser.normalise(OBSERVATIONS)
    student.reset()
    np.testing.assert_array_equal(student.normaliser.normalise(OBSERVATIONS), before)


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
        expected = torch.cat(model_q(student, seen), dim=1).min(dim=1).values.numpy()
    np.testing.assert_allclose(student.state_values(OBSERVATIONS), expected, atol=1e-5)


def model_q(student, seen):
    return student.model.critic(seen, student.model.actor(seen, deterministic=True))


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


def test_a_student_starts_from_the_weights_and_statistics_of_another(tmp_path):
    walker, env = small_student("ppo", seed=5), Drift()
    train(walker, env, 130)
    file = tmp_path / "walker.json"
    walker.save_start(file)
    student = small_student("ppo", seed=6, start_from=str(file))
    for _ in range(2):
        np.testing.assert_array_equal(student.act_greedily(OBSERVATIONS), walker.act_greedily(OBSERVATIONS))
        np.testing.assert_array_equal(student.state_values(OBSERVATIONS), walker.state_values(OBSERVATIONS))
        assert student.update.adam.steps == 0
        train(student, Drift(seed=3), 50)
        student.normaliser = walker.normaliser
        student.reset()
    saved, moved = tmp_path / "saved", tmp_path / "elsewhere" / "walker.json"
    for folder in (saved, moved.parent):
        folder.mkdir()
    file.rename(moved)
    student.save(saved)
    small_student("ppo", start_from=str(moved)).load(saved)


@pytest.mark.parametrize(
    ("hyper", "message"),
    [
        ({"hidden_units": [8]}, "has 229 parameters, the networks here have 61"),
        ({"gamma": 0.5}, r"walker.json is of a student .* \(3, 0.99, 10.0, 10.0\): expected \(3, 0.5, "),
        ({"start_from": "missing.json"}, "'missing.json': no such file; PPO.save_start writes one"),
    ],
)
def test_a_file_to_start_from_that_does_not_fit_is_refused(hyper, message, tmp_path):
    small_student("ppo").save_start(tmp_path / "walker.json")
    with pytest.raises(ValueError, match=message):
        small_student("ppo", **{"start_from": str(tmp_path / "walker.json"), **hyper})
