"""A greedy policy as layers in a row, from which files in other formats are made."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import FlattenExtractor
from torch import nn

from tma_ray.students.normaliser import EPSILON


class Standardise(nn.Module):
    """Takes off a mean, divides by a deviation and clips: in float64, as `Normaliser` does.

    Args:
        mean: of observations (o,).
        variance: of observations (o,).
        clip: bound of the result.
    """

    mean: torch.Tensor
    deviation: torch.Tensor

    def __init__(self, mean: NDArray[np.float64], variance: NDArray[np.float64], clip: float) -> None:
        super().__init__()
        self.register_buffer("mean", torch.tensor(mean, dtype=torch.float64))
        self.register_buffer("deviation", torch.tensor(np.sqrt(variance + EPSILON), dtype=torch.float64))
        self.clip = clip

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Returns float32 (n, o) of `inputs` (n, o)."""
        return ((inputs.double() - self.mean) / self.deviation).clamp(-self.clip, self.clip).float()


class Affine(nn.Module):
    """Multiplies each value by one number and adds another.

    Args:
        weight: factors (k,).
        bias: what is added (k,).
    """

    weight: torch.Tensor
    bias: torch.Tensor

    def __init__(self, weight: ArrayLike, bias: ArrayLike) -> None:
        super().__init__()
        for name, values in (("weight", weight), ("bias", bias)):
            self.register_buffer(name, torch.tensor(np.asarray(values), dtype=torch.float32))

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Returns (n, k) of `inputs` (n, k)."""
        return inputs * self.weight + self.bias


class Clamp(nn.Module):
    """Moves each value into its bounds.

    Args:
        low: smallest values (k,).
        high: largest values (k,).
    """

    low: torch.Tensor
    high: torch.Tensor

    def __init__(self, low: ArrayLike, high: ArrayLike) -> None:
        super().__init__()
        for name, values in (("low", low), ("high", high)):
            self.register_buffer(name, torch.tensor(np.asarray(values), dtype=torch.float32))

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Returns (n, k) of `inputs` (n, k)."""
        return torch.minimum(torch.maximum(inputs, self.low), self.high)


def in_a_row(layers: Sequence[nn.Module]) -> nn.Sequential:
    """Returns `layers` as one module that computes and does not learn."""
    return nn.Sequential(*layers).eval().requires_grad_(False)


def unscale(actions: spaces.Box) -> Affine:
    """Returns what maps actions (n, a) from [-1, 1] to their bounds."""
    low, high = (np.asarray(bound, np.float64) for bound in (actions.low, actions.high))
    return Affine((high - low) / 2, (high + low) / 2)


def acting_layers(model: BaseAlgorithm) -> nn.Sequential:
    """Returns what `model` computes in ``predict(observations, deterministic=True)``.

    Raises:
        ValueError: its policy is not built as those of stable-baselines3 and sb3-contrib are.
    """
    policy: Any = model.policy
    actor: Any = getattr(policy, "actor", None)
    parts: list[Any]
    if isinstance(policy, ActorCriticPolicy):
        parts = [policy.pi_features_extractor, policy.mlp_extractor.policy_net, policy.action_net]
    elif hasattr(actor, "latent_pi"):
        parts = [actor.features_extractor, actor.latent_pi, actor.mu]
    elif hasattr(actor, "mu"):
        parts = [actor.features_extractor, actor.mu]  # which ends in the tangent hyperbolic
    else:
        raise ValueError(f"it is not known what a {type(policy).__name__} computes to act")
    if policy.squash_output and len(parts) == 3:
        parts.append(nn.Tanh())
    space: Any = model.action_space
    parts.append(unscale(space) if policy.squash_output else Clamp(space.low, space.high))
    return in_a_row([_plain(layer) for part in parts for layer in _leaves(part)])


def _leaves(module: nn.Module) -> Iterator[nn.Module]:
    if isinstance(module, nn.Sequential):
        for layer in module:
            yield from _leaves(layer)
    elif not isinstance(module, FlattenExtractor):  # observations are flat
        yield module


def _plain(layer: Any) -> nn.Module:
    """Returns a batch renormalisation that no longer learns as the multiplication that it is."""
    if type(layer).__name__ != "BatchRenorm1d":
        return layer  # type: ignore[no-any-return]
    mean, variance, scale, bias = (
        part.numpy(force=True).astype(np.float64)
        for part in (layer.ra_mean, layer.ra_var, layer.scale, layer.bias)
    )
    weight = (scale if layer.affine else 1.0) / np.sqrt(variance + layer.eps)
    return Affine(weight, (bias if layer.affine else 0.0) - mean * weight)
