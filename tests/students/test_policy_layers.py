"""What a saved policy computes, layer by layer, is what it does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from test_algorithms import VALUES
from test_policy_files import OBSERVATIONS, OURS, trained
from torch import nn

from tma_ray.students import PolicyFileError, Student, load_policy, policy_layers
from tma_ray.students.layers import acting_layers

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", [*OURS, *VALUES])
def test_layers_act_as_the_policy(name: str, tmp_path: Path) -> None:
    trained(name).save_policy(tmp_path)
    layers, policy = policy_layers(name, tmp_path), load_policy(name, tmp_path)
    with torch.no_grad():
        actions = layers(torch.from_numpy(OBSERVATIONS)).numpy()
    assert actions.dtype == np.float32
    np.testing.assert_allclose(actions, policy(OBSERVATIONS), atol=1e-5)
    assert not any(part.requires_grad for part in layers.parameters())
    assert not any(isinstance(layer, nn.Sequential) for layer in layers)


def test_state_dependent_exploration_is_squashed_and_bounded_as_in_its_library(tmp_path: Path) -> None:
    from stable_baselines3 import A2C, SAC
    from students_support import Drift

    observations = OBSERVATIONS[:50]
    for algorithm, keywords in (
        (A2C, {"use_sde": True, "policy_kwargs": {"squash_output": True, "activation_fn": nn.ELU}}),
        (SAC, {"use_sde": True, "policy_kwargs": {"net_arch": [8], "activation_fn": nn.GELU}}),
    ):
        model = algorithm("MlpPolicy", Drift(), device="cpu", seed=0, **keywords)
        with torch.no_grad():
            actions = acting_layers(model)(torch.from_numpy(observations)).numpy()
        np.testing.assert_allclose(actions, model.predict(observations, deterministic=True)[0], atol=1e-5)


def test_a_student_that_does_not_tell_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="Student does not define policy_layers"):
        Student.policy_layers(tmp_path)


def test_damaged_policies_are_refused(tmp_path: Path) -> None:
    trained("sac").save_policy(tmp_path)
    (tmp_path / "policy.safetensors").write_bytes(b"PK")
    with pytest.raises(PolicyFileError, match="no sound safetensors file"):
        policy_layers("sac", tmp_path)
