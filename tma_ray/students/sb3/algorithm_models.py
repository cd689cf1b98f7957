"""Models of stable-baselines3's algorithms: made, and filled with the tensors of a saved policy."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import gymnasium
import torch
from gymnasium import spaces
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from torch import nn
from torch.nn.modules.module import register_module_parameter_registration_hook

from tma_ray.students.hyperparameters import parse_hyperparameters
from tma_ray.students.policy_files import StoredPolicy
from tma_ray.students.sb3.algorithm_hyperparameters import constructor_arguments
from tma_ray.students.sb3.algorithm_names import PACKAGES

MOST_PARAMETERS = 100_000_000
"""Of all networks of a model together that a saved policy may ask for: 400 MB."""


class SpacesOnly(gymnasium.Env[Any, Any]):
    """Tells a model its spaces; the run has the environment."""

    def __init__(self, observation_space: spaces.Box, action_space: spaces.Box) -> None:
        self.observation_space = observation_space
        self.action_space = action_space


def make_model(
    algorithm: type[BaseAlgorithm],
    observation_space: spaces.Box,
    action_space: spaces.Box,
    hyperparameters: Any,
    device: torch.device,
) -> BaseAlgorithm:
    """Returns a model of `algorithm` whose networks are not yet built."""
    constructor: Any = algorithm
    model: BaseAlgorithm = constructor(
        "MlpPolicy",
        SpacesOnly(observation_space, action_space),
        device=device,
        _init_setup_model=False,
        **constructor_arguments(hyperparameters),
    )
    return model


def acting_tensors(model: BaseAlgorithm) -> dict[str, torch.Tensor]:
    """Returns what the greedy policy of `model` computes with, by the names in the policy's state.

    Off-policy algorithms of the libraries act by their actor alone. What others need cannot be known, so
    that is everything.
    """
    state: dict[str, torch.Tensor] = model.policy.state_dict()
    known = {type(model).__module__.split(".")[0], type(model.policy).__module__.split(".")[0]} <= {*PACKAGES}
    if known and isinstance(model, OffPolicyAlgorithm):
        return {name: tensor for name, tensor in state.items() if name.startswith("actor.")}
    return state


def stored_model(
    algorithm: type[BaseAlgorithm], hyperparameters_type: type, stored: StoredPolicy, device: str
) -> BaseAlgorithm:
    """Returns a model of `algorithm` that acts greedily as the one whose policy was saved.

    Raises:
        PolicyFileError: hyper-parameters of which no model can be made, or tensors that it has not.
    """
    boxes = stored.observation_space, stored.action_space
    try:
        hyperparameters: Any = parse_hyperparameters(hyperparameters_type, stored.hyperparameters)
        model: Any = make_model(algorithm, *boxes, hyperparameters, torch.device("cpu"))
        if isinstance(model, OffPolicyAlgorithm):
            model.replay_buffer = _NoExperience()  # type: ignore[assignment]
        with torch.random.fork_rng(), _bounded():  # networks are initialised before they are filled
            model._setup_model()
    except Exception as error:  # whatever a constructor makes of values that nobody checked
        stored.refuse(f"no {algorithm.__name__} can be made of its hyper-parameters: {error!r:.200}")
    acting = acting_tensors(model)
    stored.check({name: (tuple(each.shape), str(each.dtype)[6:]) for name, each in acting.items()})
    with torch.no_grad():
        for name, tensor in acting.items():
            tensor.copy_(torch.from_numpy(stored.tensors[name]))
    model.device = torch.device(device)
    model.policy.to(model.device)
    return model  # type: ignore[no-any-return]


class _NoExperience:
    """Stands where a replay buffer would be made, in a model that only acts."""


@contextmanager
def _bounded() -> Iterator[None]:
    """Refuses to build networks of more than `MOST_PARAMETERS` inside the block."""
    count = 0

    def weigh(_module: nn.Module, _name: str, parameter: nn.Parameter | None) -> None:
        nonlocal count
        count += 0 if parameter is None else parameter.numel()
        if count > MOST_PARAMETERS:
            raise ValueError(f"its networks would have more than {MOST_PARAMETERS:,} parameters")

    hook = register_module_parameter_registration_hook(weigh)
    try:
        yield
    finally:
        hook.remove()
