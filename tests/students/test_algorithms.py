"""Students by the names of stable-baselines3's and sb3-contrib's algorithms."""

import sys

import numpy as np
import pytest
import stable_baselines3
import torch
from students_support import SMALL, Drift, small_student, train

from tma_ray.components.registry import UnknownNameError
from tma_ray.components.settings import config_dict
from tma_ray.students import STUDENTS, default_hyperparameters
from tma_ray.students.sb3.algorithms import as_student, student_of

OBSERVATIONS = np.random.default_rng(0).normal(size=(20, 3)).astype(np.float32)


def test_a_deterministic_policy_explores_with_noise():
    td3 = small_student("TD3")
    train(td3, Drift(), 60)
    actions = np.array([td3.act(OBSERVATIONS[0]) for _ in range(2000)])
    mean = td3.act_greedily(OBSERVATIONS[:1])[0]
    half_widths = (td3.action_space.high - td3.action_space.low) / 2
    np.testing.assert_allclose(np.std(actions, axis=0) / half_widths, 0.1, rtol=0.1)
    np.testing.assert_allclose(actions.mean(axis=0), mean, atol=0.02)


def test_values_of_a_deterministic_policy_are_the_smaller_critics():
    td3 = small_student("TD3")
    train(td3, Drift(), 130)
    seen = torch.from_numpy(OBSERVATIONS)
    with torch.no_grad():
        expected = torch.stack(td3.model.critic(seen, td3.model.actor(seen))).amin(dim=0)[:, 0]
    np.testing.assert_allclose(td3.state_values(OBSERVATIONS), expected.numpy(), rtol=1e-5)


def test_only_values_with_an_entropy_bonus_have_one():
    """Those of an algorithm whose entropy coefficient is learned, too."""
    tqc = small_student("TQC")
    train(tqc, Drift(), 130)
    with torch.no_grad():
        torch.manual_seed(1)
        repeated = torch.from_numpy(OBSERVATIONS[:4]).repeat_interleave(5_000, dim=0)
        expected = -tqc.model.actor.action_log_prob(repeated)[1].reshape(4, -1).mean(dim=1)
        expected *= tqc.model.log_ent_coef.exp()
    bonuses = np.mean([tqc.entropy_bonuses(OBSERVATIONS[:4].repeat(500, axis=0)).reshape(4, -1)], axis=(0, 2))
    np.testing.assert_allclose(bonuses, expected.numpy(), atol=0.05)
    assert not small_student("TD3").entropy_bonuses(OBSERVATIONS).any()
    assert not small_student("A2C").entropy_bonuses(OBSERVATIONS).any()


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "sb3_contrib", None)
    student_of.cache_clear()
    with pytest.raises(UnknownNameError, match="pip install sb3-contrib"):
        STUDENTS.get("TQC")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        *((name, "known: ppo, sac, stock:ppo, stock:sac") for name in ("pp", "PPO")),
        ("TQX", "did you mean 'TQC'"),
        ("TD", "did you mean 'TD3'"),
        ("stock:pp", "did you mean 'stock:ppo'"),
        ("stock:ac", "did you mean 'stock:sac'"),
    ],
)
def test_unknown_names_have_their_nearest(name, message):
    for find in (STUDENTS.get, default_hyperparameters):
        with pytest.raises(UnknownNameError, match=message):
            find(name)


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
    own, env = as_student(Patient), Drift()
    given = own.hyperparameters_type(**SMALL["TD3"], patience=7)
    assert config_dict(given).keys() == {*default_hyperparameters("TD3"), "patience"}
    assert given.gamma == 0.5
    student = own(env.observation_space, env.action_space, given, np.random.SeedSequence(0))
    train(student, env, 80)
    assert student.model.patience == 7
    assert student.model._n_updates > 0
