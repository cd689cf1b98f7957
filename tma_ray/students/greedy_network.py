"""Network of a greedy policy, in training and as tensors of a saved policy."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from tma_ray.students.base import Actions, Observations
from tma_ray.students.mlp.layout import Activation, Layout
from tma_ray.students.mlp.network import as_batch, forward, split
from tma_ray.students.mlp.rows import RowNetwork
from tma_ray.students.policy_files import StoredPolicy

MEAN = "mean"
"""Name of the last layer; hidden ones are numbered."""


class GreedyNetwork:
    """The network that gives the mean action: alone for a saved policy, with further outputs in training.

    One observation goes through a `RowNetwork`, several through `forward`; a saved policy takes the same
    ways as its student, and so gives the same bits.

    Args:
        parameters: (p,); for several observations always the present ones are applied.
        layout: of the network, whose first outputs are the means.
        action_size: number of means a.

    Attributes:
        row: for one observation; whoever changes the parameters calls `refresh`.
    """

    def __init__(self, parameters: torch.Tensor, layout: Layout, action_size: int) -> None:
        self._parameters = parameters.detach()
        self._layout, self._action_size = layout, action_size
        *hidden, (weight, bias) = split(self._parameters, layout)
        self._layers = [*hidden, (weight[:action_size], bias[:action_size])]
        self.row = RowNetwork(layout)
        self.refresh()

    def refresh(self) -> None:
        """Takes over the present parameters for single observations."""
        self.row.load(self._parameters.numpy(force=True))

    def __call__(self, observations: Observations, squash: bool) -> Actions:
        """Returns the mean actions (n, a) of `observations` (n, o), or their tangent hyperbolic."""
        if len(observations) == 1:
            mean = self.row(observations[0])[None, : self._action_size]
            return np.tanh(mean) if squash else mean
        outputs = forward(
            self._layers, as_batch(observations, self._parameters.device), self._layout.activation
        )
        means: Actions = (outputs.tanh_() if squash else outputs).numpy(force=True)
        return means

    def outputs(self, observations: Observations) -> NDArray[np.float32]:
        """Returns all outputs (n, h) for `observations` (n, o), not only the means."""
        if len(observations) == 1:
            return self.row(observations[0])[None]
        layers = split(self._parameters, self._layout)
        rows = as_batch(observations, self._parameters.device)
        values: NDArray[np.float32] = forward(layers, rows, self._layout.activation).numpy(force=True)
        return values

    def tensors(self) -> dict[str, NDArray[Any]]:
        """Returns weight (outputs, inputs) and bias (outputs,) of every layer, fit for `write_policy`."""
        return {
            f"{name}.{key}": tensor.numpy(force=True)
            for name, layer in zip(_names(len(self._layers)), self._layers, strict=True)
            for key, tensor in zip(("weight", "bias"), layer, strict=True)
        }


def tensor_kinds(stored: StoredPolicy) -> dict[str, tuple[tuple[int, ...], str]]:
    """Returns what `StoredPolicy.check` expects of the layers, whose sizes are ``hidden_units``.

    Raises:
        PolicyFileError: these are not sizes, or the activation is unknown.
    """
    units = stored.hyperparameters.get("hidden_units")
    if not isinstance(units, list) or not units or not all(type(size) is int and size > 0 for size in units):
        stored.refuse(f"hidden_units = {units!r:.80}: expected a list of sizes")
    activation = stored.hyperparameters.get("activation", Activation.RELU)
    if activation not in list(Activation):
        stored.refuse(f"activation = {activation!r:.80}: expected one of {', '.join(Activation)}")
    shapes = _layout(stored).shapes
    kinds: dict[str, tuple[tuple[int, ...], str]] = {}
    for name, shape in zip(_names(len(shapes)), shapes, strict=True):
        kinds[f"{name}.weight"] = tuple(shape), "float32"
        kinds[f"{name}.bias"] = (shape.outputs,), "float32"
    return kinds


def stored_parameters(stored: StoredPolicy) -> tuple[torch.Tensor, Layout]:
    """Returns the parameters (p,) that `stored` holds, checked before, and their layout."""
    layout = _layout(stored)
    names = _names(len(layout.shapes))
    parts = [stored.tensors[f"{name}.{key}"].reshape(-1) for name in names for key in ("weight", "bias")]
    return torch.from_numpy(np.concatenate(parts)), layout


def stored_network(stored: StoredPolicy, device: str) -> GreedyNetwork:
    """Returns the network whose layers `stored` holds, checked before, on `device`."""
    parameters, layout = stored_parameters(stored)
    return GreedyNetwork(parameters.to(device), layout, layout.sizes[-1])


def check_rows(observations: Observations, size: int) -> None:
    """Refuses observations of another shape than (n, `size`)."""
    if observations.ndim != 2 or observations.shape[1] != size:
        raise ValueError(f"observations of shape {observations.shape}: the policy expects (n, {size})")


def _layout(stored: StoredPolicy) -> Layout:
    values = stored.hyperparameters
    sizes = *stored.observation_space.shape, *values["hidden_units"], *stored.action_space.shape
    return Layout(sizes, Activation(values.get("activation", Activation.RELU)))


def _names(layers: int) -> list[str]:
    return [*(f"hidden.{index}" for index in range(layers - 1)), MEAN]
