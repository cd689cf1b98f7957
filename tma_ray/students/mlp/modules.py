"""Conversion of flat parameters from torch's modules, those of stable-baselines3's policies, and to them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias, cast

import torch
from torch import nn

from tma_ray.students.mlp.layout import Activation, Layout
from tma_ray.students.mlp.network import Network, split

Blocks: TypeAlias = Sequence[Sequence[nn.Linear]]
"""Layers in order. Those of one block share their inputs; their outputs follow one another."""


def blocks_of(module: nn.Module, *heads: nn.Module) -> Blocks:
    """Returns the linear layers of `module` in a row, and `heads` after them, which share their inputs."""
    rows: list[Sequence[nn.Linear]] = [[part] for part in module.modules() if isinstance(part, nn.Linear)]
    if heads:
        rows.append([head for head in heads if isinstance(head, nn.Linear)])
        assert len(rows[-1]) == len(heads)
    return rows


MODULES: Mapping[Activation, type[nn.Module]] = {Activation.RELU: nn.ReLU, Activation.TANH: nn.Tanh}
"""Activations as modules."""


class FlatParameters:
    """Parameters of modules moved into one vector, of which they become views: the modules go on as before.

    Args:
        networks: the layers of each network.
        others: parameters that belong to no layer; they come last.
        activation: function after each layer of a network but the last.

    Attributes:
        parameters: the modules' parameters, in the vector's order.
        values: the vector (p,).
        gradient: the values' gradient (p,), which `differentiate` writes.
        networks: the networks over parts of this vector.
        others: the values of `others`, as leaves of autograd.
    """

    def __init__(
        self,
        networks: Sequence[Blocks],
        others: Sequence[nn.Parameter] = (),
        activation: Activation = Activation.RELU,
    ) -> None:
        self.parameters: list[nn.Parameter] = []
        for block in (block for blocks in networks for block in blocks):
            self.parameters += [cast("nn.Parameter", layer.weight) for layer in block]
            self.parameters += [layer.bias for layer in block]
        self.parameters.extend(others)
        self.values = torch.cat([parameter.detach().reshape(-1) for parameter in self.parameters])
        self.gradient = torch.zeros_like(self.values)
        for parameter, view in zip(self.parameters, self.views(self.values), strict=True):
            parameter.data = view
        self.networks, start = [], 0
        for layout in (_layout(blocks, activation) for blocks in networks):
            part = slice(start, start + layout.parameters)
            self.networks.append(Network(self.values[part], layout, self.gradient[part]))
            start = part.stop
        self.others = [parameter.detach().requires_grad_() for parameter in others]
        self._others_gradient = self.views(self.gradient)[len(self.parameters) - len(others) :]

    def views(self, buffer: torch.Tensor) -> list[torch.Tensor]:
        """Returns the parts of `buffer` (p,) that belong to the parameters, in their shapes."""
        parts = torch.split(buffer, [parameter.numel() for parameter in self.parameters])
        return [part.view_as(own) for part, own in zip(parts, self.parameters, strict=True)]

    def differentiate(self, loss: torch.Tensor) -> None:
        """Writes the gradient of `loss`, which was computed with `networks` and `others`."""
        leaves = [network.parameters for network in self.networks]
        others = torch.autograd.grad(loss, [*leaves, *self.others])[len(leaves) :]
        self._keep(others)

    def backpropagate(
        self, kept: Sequence[torch.Tensor], gradient: torch.Tensor, others: Sequence[torch.Tensor] = ()
    ) -> None:
        """Writes the gradient of a loss of one network that was differentiated by hand.

        Args:
            kept: activations of the network in the forward pass.
            gradient: of the loss by the outputs (n, h).
            others: of the loss by each of `others`.
        """
        (network,) = self.networks
        network.backpropagate(kept, gradient)
        self._keep(others)

    def _keep(self, others: Sequence[torch.Tensor]) -> None:
        for memory, own in zip(self._others_gradient, others, strict=True):
            memory.copy_(own)


def as_modules(parameters: torch.Tensor, layout: Layout) -> list[nn.Module]:
    """Returns linear layers over `parameters` (p,), and the activation after each but the last."""
    modules: list[nn.Module] = []
    for weight, bias in split(parameters, layout):
        layer = nn.Linear(weight.shape[1], weight.shape[0], device="meta")  # neither filled nor initialised
        layer.weight, layer.bias = (nn.Parameter(part, requires_grad=False) for part in (weight, bias))
        modules += [layer, MODULES[layout.activation]()]
    return modules[:-1]


def _layout(blocks: Blocks, activation: Activation) -> Layout:
    outputs = [sum(layer.out_features for layer in block) for block in blocks]
    return Layout((blocks[0][0].in_features, *outputs), activation)
