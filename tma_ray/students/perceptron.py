"""Linear layers with ReLUs between, with a hand-written backward pass, and their parameters in one buffer.

Forward and backward pass are what autograd does, without its graph, without gradients that nobody
reads, and with gradients written where the optimiser wants them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeAlias, cast

import torch
from torch import nn

Blocks: TypeAlias = Sequence[Sequence[nn.Linear]]
"""Layers in order. Those of one block share their inputs; their outputs follow one another."""


def blocks_of(module: nn.Module, *heads: nn.Module) -> Blocks:
    """Returns the linear layers of `module` in a row, and `heads` after them, which share their inputs."""
    rows: list[Sequence[nn.Linear]] = [[part] for part in module.modules() if isinstance(part, nn.Linear)]
    if heads:
        rows.append([head for head in heads if isinstance(head, nn.Linear)])
        assert len(rows[-1]) == len(heads)
    return rows


class Layer(NamedTuple):
    """Views into `FlatParameters` of one block: weight (outputs, inputs), bias (outputs,), and gradients."""

    weight: torch.Tensor
    bias: torch.Tensor
    weight_gradient: torch.Tensor
    bias_gradient: torch.Tensor


class Perceptron:
    """A network over flat parameters.

    Args:
        layers: its layers in order; a ReLU follows each but the last.
    """

    def __init__(self, layers: Sequence[Layer]) -> None:
        self._layers = layers
        self._inputs: list[torch.Tensor] = []  # of every layer, at the last forward pass
        self._buffers: dict[tuple[str, int], torch.Tensor] = {}

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Returns the outputs (n, h) for `inputs` (n, i), and remembers what a backward pass needs."""
        self._inputs = [inputs]
        for index, layer in enumerate(self._layers[:-1]):
            buffer = self._buffer("outputs", index, inputs)
            inputs = torch.addmm(layer.bias, inputs, layer.weight.t(), out=buffer).relu_()
            self._inputs.append(inputs)
        return torch.addmm(self._layers[-1].bias, inputs, self._layers[-1].weight.t())

    def backward(self, gradient: torch.Tensor) -> None:
        """Writes the parameters' gradients, from the outputs' `gradient` (n, h) at the last forward pass."""
        for index in range(len(self._layers) - 1, -1, -1):
            layer, inputs = self._layers[index], self._inputs[index]
            torch.mm(gradient.t(), inputs, out=layer.weight_gradient)
            torch.sum(gradient, dim=0, out=layer.bias_gradient)
            if index:
                buffer = self._buffer("gradient", index - 1, inputs)
                gradient = _through_relu(torch.mm(gradient, layer.weight, out=buffer), inputs)

    def input_gradient(self, gradient: torch.Tensor, rows: torch.Tensor) -> torch.Tensor:
        """Returns the inputs' gradient (m, i) at some rows of the last forward pass; writes none.

        Args:
            gradient: of the outputs at those rows (m, h).
            rows: their indices (m,).
        """
        for layer, inputs in zip(reversed(self._layers[1:]), reversed(self._inputs[1:]), strict=True):
            gradient = _through_relu(torch.mm(gradient, layer.weight), inputs[rows])
        return torch.mm(gradient, self._layers[0].weight)

    def _buffer(self, use: str, index: int, like: torch.Tensor) -> torch.Tensor:
        """Returns memory for hidden layer `index`, kept from pass to pass: new pages cost time."""
        shape = len(like), len(self._layers[index].bias)
        buffer = self._buffers.get((use, index))
        if buffer is None or buffer.shape != shape:
            buffer = self._buffers[use, index] = like.new_empty(shape)
        return buffer


class FlatParameters:
    """Parameters moved into one buffer, of which they become views: their modules go on as before.

    Args:
        networks: the layers of each network.
        others: parameters that belong to no layer; they come last.

    Attributes:
        parameters: all of them, in the buffer's order.
        values: the buffer (p,).
        gradient: the values' gradient (p,).
        networks: the networks over this buffer.
    """

    def __init__(self, networks: Sequence[Blocks], others: Sequence[nn.Parameter] = ()) -> None:
        self.parameters: list[nn.Parameter] = []
        for block in (block for blocks in networks for block in blocks):
            self.parameters += [cast("nn.Parameter", layer.weight) for layer in block]
            self.parameters += [layer.bias for layer in block]
        self.parameters.extend(others)
        self.values = torch.cat([parameter.detach().reshape(-1) for parameter in self.parameters])
        self.gradient = torch.zeros_like(self.values)
        for parameter, view in zip(self.parameters, self.views(self.values), strict=True):
            parameter.data = view
        self.networks = self._networks(networks)

    def views(self, buffer: torch.Tensor) -> list[torch.Tensor]:
        """Returns the parts of `buffer` (p,) that belong to the parameters, in their shapes."""
        parts = torch.split(buffer, [parameter.numel() for parameter in self.parameters])
        return [part.view_as(own) for part, own in zip(parts, self.parameters, strict=True)]

    def _networks(self, networks: Sequence[Blocks]) -> list[Perceptron]:
        start, perceptrons = 0, []
        for blocks in networks:
            layers = []
            for block in blocks:
                outputs, inputs = sum(layer.out_features for layer in block), block[0].in_features
                middle, end = start + outputs * inputs, start + outputs * inputs + outputs
                weights = [each[start:middle].view(outputs, inputs) for each in (self.values, self.gradient)]
                biases = [each[middle:end] for each in (self.values, self.gradient)]
                layers.append(Layer(weights[0], biases[0], weights[1], biases[1]))
                start = end
            perceptrons.append(Perceptron(layers))
        return perceptrons


def _through_relu(gradient: torch.Tensor, outputs: torch.Tensor) -> torch.Tensor:
    """Returns `gradient`, in place, where the ReLU's `outputs` are over 0, and 0 elsewhere."""
    through: torch.Tensor = torch.ops.aten.threshold_backward.grad_input(
        gradient, outputs, 0, grad_input=gradient
    )
    return through
