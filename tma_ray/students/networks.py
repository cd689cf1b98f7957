"""Networks as the students use them: the trunk that PPO shares, and fast passes outside of autograd."""

from __future__ import annotations

import itertools

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
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


class Pass:
    """The linear layers of a module in a row, applied without autograd and without module calls.

    It shares the parameters' memory and so always applies the present ones, at half the time of
    calling the modules under `torch.inference_mode`; results are equal to the last bit.

    Args:
        module: its linear layers are taken in order.
        relu: whether a ReLU follows every layer.
    """

    def __init__(self, module: nn.Module, relu: bool) -> None:
        linear = [layer for layer in module.modules() if isinstance(layer, nn.Linear)]
        self._layers = [(layer.bias.detach(), layer.weight.detach().t()) for layer in linear]
        self._relu = relu

    def __call__(self, inputs: torch.Tensor) -> torch.Tensor:
        """Returns the last layer's outputs (n, h) for `inputs` (n, i)."""
        for bias, weight in self._layers:
            inputs = torch.addmm(bias, inputs, weight)
            if self._relu:
                inputs = inputs.relu_()
        return inputs


def as_batch(observations: NDArray[np.float32], device: torch.device) -> torch.Tensor:
    """Returns `observations` (o,) or (n, o) as a tensor (1, o) or (n, o) on `device`."""
    rows = torch.from_numpy(np.asarray(observations, dtype=np.float32))
    return (rows if rows.ndim == 2 else rows[None]).to(device)
