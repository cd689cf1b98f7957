"""The network of a greedy policy, as students act with it, and as tensors of a saved policy."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from tma_ray.students.base import Actions, Observations
from tma_ray.students.mirror import Mirror
from tma_ray.students.networks import Pass, as_batch
from tma_ray.students.policy_files import StoredPolicy

MEAN = "mean"
"""Name of the last layer; hidden ones are numbered."""


class MeanNetwork:
    """Hidden layers with ReLUs, and a last one that gives the mean action; never trained.

    One observation goes through a `Mirror`, several through a `Pass`: as in the student, and so with the
    same bits.

    Args:
        layers: in order, the last one without a ReLU.
        squash: whether actions are the tangent hyperbolic of what comes out.
    """

    def __init__(self, layers: Sequence[nn.Linear], squash: bool) -> None:
        self._hidden = Pass(nn.Sequential(*layers[:-1]), relu=True)
        self._head = Pass(layers[-1], relu=False)
        self._mirror = Mirror([[layer] for layer in layers])
        self._device = layers[0].weight.device
        self._squash = squash

    def __call__(self, observations: Observations) -> Actions:
        """Returns the mean actions (n, a) of `observations` (n, o)."""
        if len(observations) == 1:
            mean = self._mirror(observations[0])[None]
            return np.tanh(mean) if self._squash else mean
        outputs = self._head(self._hidden(as_batch(observations, self._device)))
        means: Actions = (outputs.tanh_() if self._squash else outputs).numpy(force=True)
        return means


def check_rows(observations: Observations, size: int) -> None:
    """Refuses observations of another shape than (n, `size`)."""
    if observations.ndim != 2 or observations.shape[1] != size:
        raise ValueError(f"observations of shape {observations.shape}: the policy expects (n, {size})")


def layer_tensors(hidden: nn.Module, mean: nn.Module) -> dict[str, NDArray[Any]]:
    """Returns weight (outputs, inputs) and bias (outputs,) of every linear layer, fit for `write_policy`."""
    layers = [layer for layer in hidden.modules() if isinstance(layer, nn.Linear)]
    named = {**{f"hidden.{index}": layer for index, layer in enumerate(layers)}, MEAN: mean}
    return {
        f"{name}.{key}": tensor.numpy(force=True)
        for name, layer in named.items()
        for key, tensor in layer.state_dict().items()
    }


def layer_kinds(stored: StoredPolicy) -> dict[str, tuple[tuple[int, ...], str]]:
    """Returns what `StoredPolicy.check` expects of the layers, whose sizes are ``hidden_units``.

    Raises:
        PolicyFileError: these are not sizes.
    """
    units = stored.hyperparameters.get("hidden_units")
    if not isinstance(units, list) or not units or not all(type(size) is int and size > 0 for size in units):
        stored.refuse(f"hidden_units = {units!r:.80}: expected a list of sizes")
    sizes = (*stored.observation_space.shape, *units, *stored.action_space.shape)
    kinds: dict[str, tuple[tuple[int, ...], str]] = {}
    for index, (inputs, outputs) in enumerate(itertools.pairwise(sizes)):
        name = MEAN if index == len(units) else f"hidden.{index}"
        kinds[f"{name}.weight"] = (outputs, inputs), "float32"
        kinds[f"{name}.bias"] = (outputs,), "float32"
    return kinds


def stored_network(stored: StoredPolicy, squash: bool, device: str) -> MeanNetwork:
    """Returns the network whose layers `stored` holds, checked before, on `device`."""
    return MeanNetwork(stored_layers(stored, device), squash)


def stored_layers(stored: StoredPolicy, device: str) -> list[nn.Linear]:
    """Returns the layers that `stored` holds, checked before, in order, on `device`."""
    count = len(stored.hyperparameters["hidden_units"])
    names = [*(f"hidden.{index}" for index in range(count)), MEAN]
    layers = []
    for name in names:
        weight, bias = (torch.tensor(stored.tensors[f"{name}.{key}"]) for key in ("weight", "bias"))
        layer = nn.Linear(weight.shape[1], weight.shape[0], device="meta")  # neither filled nor initialised
        layer.weight, layer.bias = (
            nn.Parameter(part.to(device), requires_grad=False) for part in (weight, bias)
        )
        layers.append(layer)
    return layers
