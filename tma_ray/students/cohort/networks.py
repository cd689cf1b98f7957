"""Forward passes of stacked networks over padded flat parameters, differentiable by autograd."""

from __future__ import annotations

from typing import Any

import torch

from tma_ray.students.cohort.padding import PaddedLayout
from tma_ray.students.mlp.layout import Activation
from tma_ray.students.mlp.network import Layers, activate, activations, forward, input_gradient, split


def stacked_pass(
    parameters: torch.Tensor, layout: PaddedLayout, inputs: torch.Tensor, hidden: torch.dtype
) -> torch.Tensor:
    """Returns the outputs (k, n, h) of k networks.

    Args:
        parameters: padded (k, p).
        layout: of each network.
        inputs: without padding (k, n, i).
        hidden: type in which hidden layers are computed; the last layer is in that of the parameters.
    """
    layers, activation = _layers(parameters, layout), layout.padded.activation
    if _pays_by_rows(parameters, inputs) and hidden == parameters.dtype:
        outputs: torch.Tensor = _pass_by_rows(layout.inputs(inputs), layers, activation)
        return outputs
    last = layers[-1:]
    if hidden != parameters.dtype:
        layers = _layers(parameters.to(hidden), layout)
    values = activate(forward(layers[:-1], layout.inputs(inputs).to(hidden), activation), activation)
    return forward(last, values.to(parameters.dtype))


def twin_pass(
    parameters: torch.Tensor, layout: PaddedLayout, inputs: torch.Tensor, hidden: torch.dtype
) -> torch.Tensor:
    """Returns the values (k, n, 2) of k pairs of critics with `parameters` (k, 2, p); see `stacked_pass`."""
    runs, batch, size = inputs.shape
    both = inputs[:, None].expand(runs, 2, batch, size).flatten(0, 1)
    outputs = stacked_pass(parameters.flatten(0, 1), layout, both, hidden)
    return outputs.view(runs, 2, batch).mT


class _PassByRows(torch.autograd.Function):
    """A pass that is differentiated by the inputs only, network by network, by the rows with a gradient.

    The smaller value of a pair of critics counts, so each has a gradient in about half of the rows.
    """

    @staticmethod
    def forward(ctx: Any, inputs: torch.Tensor, layers: Layers, activation: Activation) -> torch.Tensor:
        *kept, outputs = activations(layers, inputs, activation)
        ctx.save_for_backward(*kept)
        ctx.layers, ctx.activation = layers, activation
        return outputs

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, None, None]:
        (gradient,), kept, parts = gradients, ctx.saved_tensors, []
        for own in range(len(gradient)):
            layers = [(weight[own], bias[own]) for weight, bias in ctx.layers]
            rows = [values[own] for values in kept]
            parts.append(input_gradient(layers, rows, gradient[own], ctx.activation))
        return torch.stack(parts), None, None


_pass_by_rows: Any = _PassByRows.apply


def _pays_by_rows(parameters: torch.Tensor, inputs: torch.Tensor) -> bool:
    """Returns whether to leave rows out: not on a GPU, which would be waited for, nor in compiled code."""
    eager = parameters.device.type == "cpu" and not torch.compiler.is_compiling()
    return eager and inputs.requires_grad and not parameters.requires_grad


def _layers(parameters: torch.Tensor, layout: PaddedLayout) -> Layers:
    return split(parameters[:, : layout.padded.parameters], layout.padded)
