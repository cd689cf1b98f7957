"""Greedy policies as sequences of torch layers, for export to other formats."""

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

from tma_ray.students.base import Actions, Observations
from tma_ray.students.mlp.acting import RowNetwork
from tma_ray.students.mlp.layout import Activation, Layout
from tma_ray.students.mlp.network import as_batch, forward, split
from tma_ray.students.normaliser import EPSILON
from tma_ray.students.policy_files import StoredPolicy


class Standardise(nn.Module):
    """Layer that normalises observations in float64, by `mean` (o,) and `variance` (o,), and clips them."""

    mean: torch.Tensor
    deviation: torch.Tensor

    def __init__(self, mean: NDArray[np.float64], variance: NDArray[np.float64], clip: float) -> None:
        super().__init__()
        self.register_buffer("mean", torch.tensor(mean, dtype=torch.float64))
        self.register_buffer("deviation", torch.tensor(np.sqrt(variance + EPSILON), dtype=torch.float64))
        self.clip = clip

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return `inputs` (n, o), normalised and clipped, as float32."""
        return ((inputs.double() - self.mean) / self.deviation).clamp(-self.clip, self.clip).float()


class Affine(nn.Module):
    """Layer that scales values by `weight` (k,) and shifts them by `bias` (k,)."""

    weight: torch.Tensor
    bias: torch.Tensor

    def __init__(self, weight: ArrayLike, bias: ArrayLike) -> None:
        super().__init__()
        _register(self, weight=weight, bias=bias)

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return the outputs (n, k) for `inputs` (n, k)."""
        return inputs * self.weight + self.bias


class Clamp(nn.Module):
    """Layer that clips values to the bounds `low` (k,) and `high` (k,)."""

    low: torch.Tensor
    high: torch.Tensor

    def __init__(self, low: ArrayLike, high: ArrayLike) -> None:
        super().__init__()
        _register(self, low=low, high=high)

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return the outputs (n, k) for `inputs` (n, k)."""
        return torch.minimum(torch.maximum(inputs, self.low), self.high)


def _register(module: nn.Module, **buffers: ArrayLike) -> None:
    for name, values in buffers.items():
        module.register_buffer(name, torch.tensor(np.asarray(values), dtype=torch.float32))


def as_sequential(layers: Sequence[nn.Module]) -> nn.Sequential:
    """Return `layers` as a single frozen module in evaluation mode."""
    return nn.Sequential(*layers).eval().requires_grad_(False)


def unscale(actions: spaces.Box) -> Affine:
    """Return the layer that maps actions (n, a) from [-1, 1] to the bounds of the space `actions`."""
    low, high = (np.asarray(bound, np.float64) for bound in (actions.low, actions.high))
    return Affine((high - low) / 2, (high + low) / 2)


def acting_layers(model: BaseAlgorithm) -> nn.Sequential:
    """Return the layers that compute ``predict(observations, deterministic=True)`` of `model`.

    Raises:
        ValueError: if its policy class is not supported.
    """
    policy: Any = model.policy
    actor: Any = getattr(policy, "actor", None)
    modules: list[Any]
    if isinstance(policy, ActorCriticPolicy):
        modules = [policy.pi_features_extractor, policy.mlp_extractor.policy_net, policy.action_net]
    elif hasattr(actor, "latent_pi"):
        modules = [actor.features_extractor, actor.latent_pi, actor.mu]
    elif hasattr(actor, "mu"):
        modules = [actor.features_extractor, actor.mu]  # `mu` itself ends in a tanh
    else:
        raise ValueError(f"it is not known what a {type(policy).__name__} computes to act")
    if policy.squash_output and len(modules) == 3:
        modules.append(nn.Tanh())
    space: Any = model.action_space
    modules.append(unscale(space) if policy.squash_output else Clamp(space.low, space.high))
    return as_sequential([_without_batch_norm(layer) for module in modules for layer in _leaves(module)])


def _leaves(module: nn.Module) -> Iterator[nn.Module]:
    if isinstance(module, nn.Sequential):
        for layer in module:
            yield from _leaves(layer)
    elif not isinstance(module, FlattenExtractor):  # which does nothing: observations are flat
        yield module


def _without_batch_norm(layer: Any) -> nn.Module:
    """Replace a batch renormalisation layer by an equivalent `Affine`, and return other layers unchanged."""
    if type(layer).__name__ != "BatchRenorm1d":
        return layer  # type: ignore[no-any-return]
    mean, variance, scale, bias = (
        tensor.numpy(force=True).astype(np.float64)
        for tensor in (layer.ra_mean, layer.ra_var, layer.scale, layer.bias)
    )
    weight = (scale if layer.affine else 1.0) / np.sqrt(variance + layer.eps)
    return Affine(weight, (bias if layer.affine else 0.0) - mean * weight)


MEAN = "mean"  # name of the last layer; hidden layers are numbered


class GreedyNetwork:
    """Network that computes mean actions, bit for bit the same in students and saved policies.

    Its first outputs are the means. Single observations use `row`, a copy of `parameters` (p,) that `refresh`
    updates, and batches the parameters themselves.
    """

    def __init__(self, parameters: torch.Tensor, layout: Layout, action_size: int) -> None:
        self._parameters = parameters.detach()
        self._layout, self._action_size = layout, action_size
        *hidden, (weight, bias) = split(self._parameters, layout)
        self._layers = [*hidden, (weight[:action_size], bias[:action_size])]
        self.row = RowNetwork(layout)
        self.refresh()

    def refresh(self) -> None:
        """Copy the parameters to `row`."""
        self.row.load(self._parameters.numpy(force=True))

    def __call__(self, observations: Observations, squash: bool) -> Actions:
        """Return the mean actions (n, a) for `observations` (n, o), squashed by tanh if `squash`."""
        if len(observations) == 1:
            mean = self.row(observations[0])[None, : self._action_size]
            return np.tanh(mean) if squash else mean
        outputs = forward(
            self._layers, as_batch(observations, self._parameters.device), self._layout.activation
        )
        means: Actions = (outputs.tanh_() if squash else outputs).numpy(force=True)
        return means

    def outputs(self, observations: Observations) -> NDArray[np.float32]:
        """Return all outputs (n, h) for `observations` (n, o)."""
        if len(observations) == 1:
            return self.row(observations[0])[None]
        layers = split(self._parameters, self._layout)
        rows = as_batch(observations, self._parameters.device)
        values: NDArray[np.float32] = forward(layers, rows, self._layout.activation).numpy(force=True)
        return values

    def tensors(self) -> dict[str, NDArray[Any]]:
        """Return the weights and biases of all layers, by name, for `write_policy`."""
        return {
            f"{name}.{key}": tensor.numpy(force=True)
            for name, layer in zip(_names(len(self._layers)), self._layers, strict=True)
            for key, tensor in zip(("weight", "bias"), layer, strict=True)
        }


def tensor_specs(stored: StoredPolicy) -> dict[str, tuple[tuple[int, ...], str]]:
    """Return the shapes and types of all layers' tensors by name, for `StoredPolicy.check`."""
    units = stored.hyperparameters.get("hidden_units")
    if not isinstance(units, list) or not units or not all(type(size) is int and size > 0 for size in units):
        stored.refuse(f"hidden_units = {units!r:.80}: expected a list of sizes")
    activation = stored.hyperparameters.get("activation", Activation.RELU)
    if activation not in list(Activation):
        stored.refuse(f"activation = {activation!r:.80}: expected one of {', '.join(Activation)}")
    shapes = _layout(stored).shapes
    kinds: dict[str, tuple[tuple[int, ...], str]] = {}
    for name, shape in zip(_names(len(shapes)), shapes, strict=True):
        kinds[f"{name}.weight"] = shape, "float32"
        kinds[f"{name}.bias"] = shape[:1], "float32"
    return kinds


def stored_parameters(stored: StoredPolicy) -> tuple[torch.Tensor, Layout]:
    """Return the parameters (p,) of a checked policy, and their layout."""
    layout = _layout(stored)
    names = _names(len(layout.shapes))
    vectors = [stored.tensors[f"{name}.{key}"].reshape(-1) for name in names for key in ("weight", "bias")]
    return torch.from_numpy(np.concatenate(vectors)), layout


def stored_network(stored: StoredPolicy, device: str) -> GreedyNetwork:
    """Return the network of a checked policy on `device`."""
    parameters, layout = stored_parameters(stored)
    return GreedyNetwork(parameters.to(device), layout, layout.sizes[-1])


def check_rows(observations: Observations, size: int) -> None:
    """Check that observations have the shape (n, `size`)."""
    if observations.ndim != 2 or observations.shape[1] != size:
        raise ValueError(f"observations of shape {observations.shape}: the policy expects (n, {size})")


def _layout(stored: StoredPolicy) -> Layout:
    values = stored.hyperparameters
    sizes = *stored.observation_space.shape, *values["hidden_units"], *stored.action_space.shape
    return Layout(sizes, Activation(values.get("activation", Activation.RELU)))


def _names(layers: int) -> list[str]:
    return [*(f"hidden.{index}" for index in range(layers - 1)), MEAN]
