"""Trunk of hidden layers that PPO's policy and value share."""

from __future__ import annotations

import itertools

import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn


class Trunk(BaseFeaturesExtractor):
    """Hidden layers that policy and value share.

    stable-baselines3 shares features extractors, no longer hidden layers; so these are one.

    Args:
        observation_space: a one-dimensional box.
        hidden_units: units per layer, each followed by a ReLU.
    """

    def __init__(self, observation_space: spaces.Box, hidden_units: tuple[int, ...]) -> None:
        super().__init__(observation_space, features_dim=hidden_units[-1])
        sizes = (observation_space.shape[0], *hidden_units)
        layers: list[nn.Module] = []
        for size_in, size_out in itertools.pairwise(sizes):
            layers += [nn.Linear(size_in, size_out), nn.ReLU()]
        self.layers = nn.Sequential(*layers)

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Returns the last hidden layer (n, h) of `observations` (n, o)."""
        features: torch.Tensor = self.layers(observations)
        return features
