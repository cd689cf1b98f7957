"""Trunk of hidden layers that PPO's policy and value share, or two of them side by side."""

from __future__ import annotations

import itertools
import math

import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn

from tma_ray.students.mlp.layout import Activation
from tma_ray.students.mlp.modules import MODULES


class Trunk(BaseFeaturesExtractor):
    """Hidden layers that policy and value share.

    stable-baselines3 shares features extractors, no longer hidden layers; so these are one.

    Args:
        observation_space: a one-dimensional box.
        hidden_units: units per layer, each followed by the activation.
        activation: function after each layer.
    """

    def __init__(
        self,
        observation_space: spaces.Box,
        hidden_units: tuple[int, ...],
        activation: Activation = Activation.RELU,
    ) -> None:
        super().__init__(observation_space, features_dim=hidden_units[-1])
        sizes = (observation_space.shape[0], *hidden_units)
        layers: list[nn.Module] = []
        for size_in, size_out in itertools.pairwise(sizes):
            layers += [nn.Linear(size_in, size_out), MODULES[activation]()]
        self.layers = nn.Sequential(*layers)

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Returns the last hidden layer (n, h) of `observations` (n, o)."""
        features: torch.Tensor = self.layers(observations)
        return features


@torch.no_grad()
def separate(trunk: Trunk, means: nn.Linear, value: nn.Linear) -> None:
    """Initialises two networks side by side, as stable-baselines3 does with separate ones.

    The first half of each hidden layer leads to the means, the second to the value; weights between halves
    are 0.

    Args:
        trunk: hidden layers of both.
        means: last layer of the first.
        value: last layer of the second.
    """
    hidden = [layer.weight for layer in trunk.layers if isinstance(layer, nn.Linear)]
    for index, weight in enumerate(hidden):
        outputs, inputs = weight.shape[0] // 2, weight.shape[1] // 2
        halves = [weight[:outputs], weight[outputs:]]
        if index:
            weight.zero_()
            halves = [halves[0][:, :inputs], halves[1][:, inputs:]]
        for half in halves:
            nn.init.orthogonal_(half, math.sqrt(2))
    for weight, gain, own in (
        (means.weight, 0.01, slice(outputs)),
        (value.weight, 1.0, slice(outputs, None)),
    ):
        weight.zero_()
        nn.init.orthogonal_(weight[:, own], gain)
