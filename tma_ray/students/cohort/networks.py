"""Forward passes of stacked networks over padded flat parameters, differentiable by autograd."""

from __future__ import annotations

import torch

from tma_ray.students.cohort.padding import PaddedLayout
from tma_ray.students.mlp.network import Layers, split


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
    layers = _layers(parameters, layout)
    weight, bias = layers[-1]
    if hidden != parameters.dtype:
        layers = _layers(parameters.to(hidden), layout)
    values = layout.inputs(inputs).to(hidden)
    for hidden_weight, hidden_bias in layers[:-1]:
        values = torch.baddbmm(hidden_bias[:, None], values, hidden_weight.mT).relu_()
    return torch.baddbmm(bias[:, None], values.to(bias.dtype), weight.mT)


def twin_pass(
    parameters: torch.Tensor, layout: PaddedLayout, inputs: torch.Tensor, hidden: torch.dtype
) -> torch.Tensor:
    """Returns the values (k, n, 2) of k pairs of critics with `parameters` (k, 2, p); see `stacked_pass`."""
    runs, batch, size = inputs.shape
    both = inputs[:, None].expand(runs, 2, batch, size).flatten(0, 1)
    outputs = stacked_pass(parameters.flatten(0, 1), layout, both, hidden)
    return outputs.view(runs, 2, batch).mT


def _layers(parameters: torch.Tensor, layout: PaddedLayout) -> Layers:
    return split(parameters[:, : layout.padded.parameters], layout.padded)
