import json
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box
from students_support import SMALL

from tma_ray.components.settings import config_dict
from tma_ray.students import (
    STUDENTS,
    PPOHyperparameters,
    SACHyperparameters,
    Student,
    canonical_student,
    check_hyperparameters,
    default_hyperparameters,
    make_student,
)


def test_defaults_are_the_papers():
    ppo, sac = default_hyperparameters("ppo"), default_hyperparameters("sac")
    assert ppo["hidden_units"] == sac["hidden_units"] == [400, 300]
    assert ppo["gamma"] == sac["gamma"] == 0.99
    assert (ppo["steps_per_update"], ppo["epochs"], ppo["batch_size"]) == (2000, 5, 1000)
    assert (ppo["learning_rate"], ppo["gae_lambda"], ppo["clip_range"]) == (3e-4, 0.95, 0.2)
    assert (ppo["max_gradient_norm"], ppo["value_coefficient"], ppo["entropy_coefficient"]) == (0.5, 0.5, 0.0)
    assert (sac["learning_rate"], sac["entropy_coefficient"]) == (1e-3, 0.005)
    assert (sac["steps_per_update"], sac["batch_size"], sac["buffer_size"]) == (10, 1000, 2_000_000)


@pytest.mark.parametrize("name", SMALL)
def test_defaults_survive_json(name):
    values = json.loads(json.dumps(default_hyperparameters(name)))
    assert values == default_hyperparameters(name)
    assert check_hyperparameters(name, values) == check_hyperparameters(name)


def test_later_hyperparameters_change_no_identity_at_their_defaults():
    later = {"activation": "tanh", "separate_trunks": True, "averaged_steps": 10}
    names = default_hyperparameters("ppo").keys() - later.keys()
    assert config_dict(check_hyperparameters("ppo")).keys() == names
    assert config_dict(check_hyperparameters("ppo", later)).items() >= later.items()
    name = canonical_student("ppo:activation=relu:averaged_steps=10:separate_trunks=false")
    assert name == "ppo:averaged_steps=10"


def test_given_values_replace_defaults():
    assert check_hyperparameters("sac", {"learning_rate": 1}) == SACHyperparameters(learning_rate=1.0)
    assert check_hyperparameters("ppo", {"value_clip_range": None}).value_clip_range is None
    assert check_hyperparameters("ppo", {"hidden_units": [8]}) == PPOHyperparameters(hidden_units=(8,))


@pytest.mark.parametrize(
    ("name", "key", "value", "message"),
    [
        ("ppo", "learning_rat", 1e-3, "did you mean 'learning_rate'"),
        ("sac", "clip_range", 0.2, "unknown hyper-parameter 'clip_range'"),
        ("ppo", "learning_rate", "fast", "learning_rate = 'fast': expected finite float"),
        ("ppo", "learning_rate", float("nan"), "expected finite float"),
        ("ppo", "learning_rate", True, "expected finite float"),
        ("ppo", "learning_rate", 0, "expected more than 0"),
        ("ppo", "epochs", 5.0, "epochs = 5.0: expected int"),
        ("ppo", "epochs", True, "expected int"),
        ("ppo", "epochs", None, "expected int"),
        ("ppo", "hidden_units", [4, "a"], "expected int"),
        ("ppo", "hidden_units", 400, "hidden_units = 400"),
        ("ppo", "hidden_units", [], "at least one layer"),
        ("ppo", "gamma", 1.5, r"gamma = 1.5: expected a share in \[0, 1\]"),
        ("ppo", "batch_size", 300, "a divisor of steps_per_update = 2000"),
        ("ppo", "batch_size", 1, "more than 1"),
        ("ppo", "value_clip_range", -1, "expected more than 0"),
        ("ppo", "activation", "tahn", "did you mean 'tanh'"),
        ("ppo", "averaged_steps", -1, "averaged_steps = -1: expected at least 0"),
        ("sac", "buffer_size", 0, "expected more than 0"),
        ("sac", "exploration_steps", -1, "exploration_steps = -1: expected at least 0"),
        ("TD3", "learning_rat", 1e-3, "did you mean 'learning_rate'"),
        ("TD3", "batch_size", 1.5, "expected int"),
        ("TD3", "batch_size", 0, "expected more than 0"),
        ("TD3", "policy_kwargs", {"activation_fn": torch.nn.ReLU}, "that JSON has"),
        ("TD3", "seed", 1, "unknown hyper-parameter 'seed'"),
        ("TD3", "exploration_deviation", -1, "expected 0 or more"),
        ("TD3", "matmul_precision", "low", "expected one of highest, high, medium"),
    ],
)
def test_unfit_values_are_refused_with_a_helpful_message(name, key, value, message):
    with pytest.raises(ValueError, match=message):
        check_hyperparameters(name, {key: value})


def test_a_student_of_someone_else_is_made_and_checked_alike(monkeypatch):
    @dataclass(frozen=True)
    class Patience:
        steps: int = 3

    class Idle(Student):
        hyperparameters_type = Patience

        def __init__(self, observation_space, action_space, hyperparameters, seed, device, threads):
            self.given = observation_space, action_space, hyperparameters, seed, device, threads

    monkeypatch.setattr(STUDENTS, "_decorated", {})
    Idle.__abstractmethods__ = frozenset()  # it is only made
    STUDENTS.register("idle")(Idle)
    assert default_hyperparameters("idle") == {"steps": 3}
    parts = Box(-1, 1, (3,)), Box(-1, 1, (2,)), np.random.SeedSequence(0)
    student = make_student("idle", *parts, {"steps": 5}, threads=2)
    assert student.given == (*parts[:2], Patience(5), parts[2], "cpu", 2)
    with pytest.raises(ValueError, match="did you mean 'steps'"):
        make_student("idle", *parts, {"step": 5})
