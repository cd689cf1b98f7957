"""Students by the names of stable-baselines3's and sb3-contrib's algorithms."""

import sys

import numpy as np
import pytest
import stable_baselines3
import torch
from students_support import Drift, digest, parameters, train, train_episodes

from tma_ray.hyperparameters import identifying
from tma_ray.registry import UnknownNameError
from tma_ray.students import (
    STUDENTS,
    check_hyperparameters,
    default_hyperparameters,
    make_student,
)
from tma_ray.students.sb3.algorithms import as_student, student_of

OBSERVATIONS = np.random.default_rng(0).normal(size=(20, 3)).astype(np.float32)
SMALL = {"policy_kwargs": {"net_arch": [16, 8]}}
OFF_POLICY = {**SMALL, "buffer_size": 150, "batch_size": 20, "learning_starts": 60, "train_freq": 10}
VALUES = {
    "A2C": {**SMALL, "n_steps": 20},
    "CrossQ": OFF_POLICY,
    "DDPG": OFF_POLICY,
    "TD3": OFF_POLICY,
    "TQC": OFF_POLICY,
    "TRPO": {**SMALL, "n_steps": 60, "batch_size": 30},
}


def student(name: str, seed: int = 0):
    env = Drift()
    return make_student(
        name, env.observation_space, env.action_space, np.random.SeedSequence(seed), VALUES[name]
    )


NAMES = pytest.mark.parametrize("name", sorted(VALUES))


@NAMES
def test_every_algorithm_learns_resumes_and_leaves_the_global_generators(name, tmp_path):
    before = torch.get_rng_state().tolist(), np.random.get_state()[1].tolist()  # noqa: NPY002
    first = student(name)
    initial = parameters(first)
    train_episodes(first, range(8))
    assert any((initial[key] != value).any() for key, value in parameters(first).items())
    digest(first, tmp_path / "first")
    second = student(name, seed=9)
    second.load(tmp_path / "first")
    assert train_episodes(first, range(8, 14)) == train_episodes(second, range(8, 14))
    assert digest(first, tmp_path / "a") == digest(second, tmp_path / "b")
    values = first.state_values(OBSERVATIONS)
    assert values.shape == (20,)
    assert values.dtype == np.float64
    assert np.isfinite(values).all()
    actions = first.act_greedily(OBSERVATIONS)
    assert actions.shape == (20, 2)
    first.reset()
    train(first, Drift(), 80)
    assert (torch.get_rng_state().tolist(), np.random.get_state()[1].tolist()) == before  # noqa: NPY002


def test_a_deterministic_policy_explores_with_noise():
    td3 = student("TD3")
    train(td3, Drift(), 60)
    actions = np.array([td3.act(OBSERVATIONS[0]) for _ in range(2000)])
    mean = td3.act_greedily(OBSERVATIONS[:1])[0]
    half_widths = (td3.action_space.high - td3.action_space.low) / 2
    np.testing.assert_allclose(np.std(actions, axis=0) / half_widths, 0.1, rtol=0.1)
    np.testing.assert_allclose(actions.mean(axis=0), mean, atol=0.02)


def test_values_of_a_deterministic_policy_are_the_smaller_critics():
    td3 = student("TD3")
    train(td3, Drift(), 130)
    seen = torch.from_numpy(OBSERVATIONS)
    with torch.no_grad():
        expected = torch.stack(td3.model.critic(seen, td3.model.actor(seen))).amin(dim=0)[:, 0]
    np.testing.assert_allclose(td3.state_values(OBSERVATIONS), expected.numpy(), rtol=1e-5)


def test_only_values_with_an_entropy_bonus_have_one():
    """Those of an algorithm whose entropy coefficient is learned, too."""
    tqc = student("TQC")
    train(tqc, Drift(), 130)
    with torch.no_grad():
        torch.manual_seed(1)
        repeated = torch.from_numpy(OBSERVATIONS[:4]).repeat_interleave(5_000, dim=0)
        expected = -tqc.model.actor.action_log_prob(repeated)[1].reshape(4, -1).mean(dim=1)
        expected *= tqc.model.log_ent_coef.exp()
    bonuses = np.mean([tqc.entropy_bonuses(OBSERVATIONS[:4].repeat(500, axis=0)).reshape(4, -1)], axis=(0, 2))
    np.testing.assert_allclose(bonuses, expected.numpy(), atol=0.05)
    assert not student("TD3").entropy_bonuses(OBSERVATIONS).any()
    assert not student("A2C").entropy_bonuses(OBSERVATIONS).any()


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("learning_rat", 1e-3, "did you mean 'learning_rate'"),
        ("batch_size", 1.5, "expected int"),
        ("batch_size", 0, "expected more than 0"),
        ("policy_kwargs", {"activation_fn": torch.nn.ReLU}, "that JSON has"),
        ("seed", 1, "unknown hyper-parameter 'seed'"),
        ("exploration_deviation", -1, "expected 0 or more"),
        ("matmul_precision", "low", "expected one of highest, high, medium"),
    ],
)
def test_unfit_arguments_are_refused(key, value, message):
    with pytest.raises(ValueError, match=message):
        check_hyperparameters("TD3", {key: value})


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "sb3_contrib", None)
    student_of.cache_clear()
    with pytest.raises(UnknownNameError, match="pip install sb3-contrib"):
        STUDENTS.get("TQC")


@pytest.mark.parametrize(
    ("name", "nearest"),
    [("TQX", "'TQC'"), ("stock:pp", "'stock:ppo'"), ("stock:ac", "'stock:sac'"), ("TD", "'TD3'")],
)
def test_unknown_names_have_their_nearest(name, nearest):
    with pytest.raises(UnknownNameError, match=f"did you mean {nearest}"):
        STUDENTS.get(name)


def test_stock_students_are_found_however_spelt():
    for name in ("ppo", "sac"):
        assert STUDENTS.get(f"stock:{name.upper()}") is STUDENTS.get(f"stock:{name}")
        assert default_hyperparameters(f"stock:{name.upper()}") == default_hyperparameters(name)


class Patient(stable_baselines3.TD3):
    """An algorithm of somebody's own, with a new argument and another default."""

    def __init__(self, policy, env, *, patience=3, gamma=0.5, **others):
        super().__init__(policy, env, gamma=gamma, **others)
        self.patience = patience


def test_an_algorithm_of_ones_own_has_its_arguments_and_those_it_passes_on():
    own = as_student(Patient)
    values = identifying(own.hyperparameters_type(**VALUES["TD3"], patience=7))
    assert values.keys() == {*default_hyperparameters("TD3"), "patience"}
    assert values["gamma"] == 0.5
    env = Drift()
    student = own(
        env.observation_space,
        env.action_space,
        own.hyperparameters_type(**VALUES["TD3"], patience=7),
        np.random.SeedSequence(0),
    )
    train(student, env, 80)
    assert student.model.patience == 7
    assert student.model._n_updates > 0
