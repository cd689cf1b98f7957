"""Hyper-parameters of any stable-baselines3 algorithm: the arguments of its constructor."""

from __future__ import annotations

import copy
import dataclasses
import inspect
from typing import Any

from stable_baselines3 import TD3
from stable_baselines3.common.base_class import BaseAlgorithm

from tma_ray.students.hyperparameters import MatmulPrecision

NOT_OURS = frozenset(
    {
        *("self", "policy", "env", "seed", "device", "verbose", "tensorboard_log", "stats_window_size"),
        *("_init_setup_model", "monitor_wrapper", "support_multi_env", "supported_action_spaces"),
        *("replay_buffer_class", "replay_buffer_kwargs", "rollout_buffer_class", "rollout_buffer_kwargs"),
        *("optimize_memory_usage", "action_noise", "n_steps_return"),
        *("use_sde", "sde_sample_freq", "use_sde_at_warmup"),
    }
)
"""Arguments that the student gives itself, or that concern the loop and the buffers, which are its own."""

_POSITIVE = ("learning_rate", "buffer_size", "batch_size", "train_freq", "n_steps")


def hyperparameters_of(algorithm: type[BaseAlgorithm], off_policy: bool) -> type:
    """Returns a frozen dataclass with the arguments of `algorithm` at their defaults.

    Args:
        algorithm: of stable-baselines3, or one that follows its conventions.
        off_policy: it learns from a replay buffer. Then the dataclass also has `exploration_deviation`,
            of normal noise on actions scaled to [-1, 1]: 0.1 where the policy is deterministic (TD3's
            paper, arXiv:1802.09477), else 0.
    """
    left_out = NOT_OURS | ({"n_steps"} if off_policy else frozenset())
    fields: list[tuple[str, Any, Any]] = []
    for name, parameter in _parameters(algorithm).items():
        if name not in left_out:
            default = parameter.default
            kind = type(default) if type(default) in (bool, int, float) else Any
            fields.append((name, kind, dataclasses.field(default=default)))
    if off_policy:
        deviation = 0.1 if issubclass(algorithm, TD3) else 0.0
        fields.append(("exploration_deviation", float, dataclasses.field(default=deviation)))
        fields.append(("value_samples", int, dataclasses.field(default=16)))
    precision = dataclasses.field(default=MatmulPrecision.HIGHEST)
    fields.append(("matmul_precision", MatmulPrecision, precision))
    name = f"{algorithm.__name__}Hyperparameters"
    return dataclasses.make_dataclass(name, fields, frozen=True, namespace={"__post_init__": _check})


def _parameters(algorithm: type[BaseAlgorithm]) -> dict[str, inspect.Parameter]:
    """Returns the named arguments of the constructor, and of the next one while that takes any keyword."""
    found: dict[str, inspect.Parameter] = {}
    constructors = (vars(kind).get("__init__") for kind in algorithm.__mro__)
    for constructor in filter(None, constructors):
        parameters = inspect.signature(constructor).parameters
        named = {
            name: parameter
            for name, parameter in parameters.items()
            if parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD)
        }
        found = {**named, **found}
        if not any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values()):
            break
    return found


def constructor_arguments(hyperparameters: Any) -> dict[str, Any]:
    """Returns what the algorithm's constructor takes of its student's `hyperparameters`, as copies."""
    own = {"exploration_deviation", "value_samples", "matmul_precision"}
    names = [field.name for field in dataclasses.fields(hyperparameters)]
    return {name: copy.deepcopy(getattr(hyperparameters, name)) for name in names if name not in own}


def _check(hyperparameters: Any) -> None:
    for name in _POSITIVE:
        value = getattr(hyperparameters, name, 1)
        if isinstance(value, (int, float)) and value <= 0:
            raise ValueError(f"hyper-parameter {name} = {value!r}: expected more than 0")
    deviation = getattr(hyperparameters, "exploration_deviation", 0)
    if deviation < 0:
        raise ValueError(f"hyper-parameter exploration_deviation = {deviation}: expected 0 or more")
