"""Stacked networks with padded flat parameters: layout, forward passes and Adam."""

import math
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from tma_ray.students.mlp.layout import Activation, Layout
from tma_ray.students.mlp.network import Layers, activate, activations, forward, input_gradient, split
from tma_ray.support.import_hacks import take_step

INPUTS_MULTIPLE = 8
HIDDEN_MULTIPLE = 16


class PaddedLayout(NamedTuple):
    """Layout of a network, both plain and with padded inputs and hidden layers."""

    plain: Layout
    padded: Layout
    others: int = 0  # number of additional parameters after the network's

    @classmethod
    def of(cls, plain: Layout, others: int = 0) -> "PaddedLayout":
        """Return the padded layout of `plain`, followed by `others` additional parameters."""
        inputs, *hidden, outputs = plain.sizes
        sizes = [_up(inputs, INPUTS_MULTIPLE), *(_up(size, HIDDEN_MULTIPLE) for size in hidden), outputs]
        return cls(plain, Layout(tuple(sizes), plain.activation), others)

    @property
    def length(self) -> int:
        """Number of parameters, including padding."""
        return _up(self.padded.parameters + self.others, HIDDEN_MULTIPLE)

    def columns(self) -> NDArray[np.int64]:
        """Return the index of each unpadded parameter (p,) in the padded vector."""
        indices, start = [], 0
        for (outputs, inputs), padded in zip(self.plain.shapes, self.padded.shapes, strict=True):
            weights = start + np.arange(math.prod(padded)).reshape(padded)
            biases = start + weights.size
            indices += [weights[:outputs, :inputs].ravel(), np.arange(biases, biases + outputs)]
            start = biases + padded[0]
        return np.concatenate([*indices, np.arange(start, start + self.others)])

    def inputs(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return `inputs` (..., i), padded with zeros."""
        missing = self.padded.sizes[0] - inputs.shape[-1]
        return torch.nn.functional.pad(inputs, (0, missing)) if missing else inputs


def _up(size: int, multiple: int) -> int:
    return -(-size // multiple) * multiple


def stacked_pass(
    parameters: torch.Tensor, layout: PaddedLayout, inputs: torch.Tensor, hidden: torch.dtype
) -> torch.Tensor:
    """Return the outputs (k, n, h) of k networks.

    Args:
        parameters: padded parameters (k, p).
        layout: layout of each network.
        inputs: inputs without padding (k, n, i).
        hidden: data type of the hidden layers; the last layer uses that of the parameters.
    """
    layers, activation = _layers(parameters, layout), layout.padded.activation
    # skipping rows with zero gradients pays off only in eager mode on a CPU: a GPU would have to synchronise
    eager = parameters.device.type == "cpu" and not torch.compiler.is_compiling()
    by_inputs_only = inputs.requires_grad and not parameters.requires_grad
    if eager and by_inputs_only and hidden == parameters.dtype:
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
    """Return the outputs (k, n, 2) of k pairs of critics with `parameters` (k, 2, p)."""
    runs, batch, size = inputs.shape
    both = inputs[:, None].expand(runs, 2, batch, size).flatten(0, 1)
    outputs = stacked_pass(parameters.flatten(0, 1), layout, both, hidden)
    return outputs.view(runs, 2, batch).mT


class _PassByRows(torch.autograd.Function):
    """Autograd function with gradients for the inputs only, skipping rows whose gradient is zero.

    The minimum over a pair of critics gives each a gradient in about half of the rows.
    """

    @staticmethod
    def forward(ctx: Any, inputs: torch.Tensor, layers: Layers, activation: Activation) -> torch.Tensor:
        *kept, outputs = activations(layers, inputs, activation)
        ctx.save_for_backward(*kept)
        ctx.layers, ctx.activation = layers, activation
        return outputs

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, None, None]:
        (gradient,), kept, results = gradients, ctx.saved_tensors, []
        for index in range(len(gradient)):
            layers = [(weight[index], bias[index]) for weight, bias in ctx.layers]
            rows = [values[index] for values in kept]
            results.append(input_gradient(layers, rows, gradient[index], ctx.activation))
        return torch.stack(results), None, None


_pass_by_rows: Any = _PassByRows.apply


def _layers(parameters: torch.Tensor, layout: PaddedLayout) -> Layers:
    return split(parameters[:, : layout.padded.parameters], layout.padded)


BETAS = 0.9, 0.999


class StackedAdam:
    """`torch.optim.Adam` over the parameters (k, ..., p) of all runs, with a step count for each run."""

    def __init__(self, parameters: torch.Tensor, rate: float, epsilon: float = 1e-8) -> None:
        self._parameters, self._rate, self._epsilon = parameters, rate, epsilon
        self.mean, self.square = torch.zeros_like(parameters), torch.zeros_like(parameters)
        # computed on the host, since devices round powers differently
        self._corrections = torch.tensor(_corrections(rate), dtype=parameters.dtype, device=parameters.device)

    def step(self, gradient: torch.Tensor, counts: torch.Tensor, active: torch.Tensor) -> None:
        """Take one optimiser step with `gradient` for the `active` runs (k,), leaving all others unchanged.

        `counts` are the previous steps of each run (k,).
        """
        shape = len(active), *[1] * (gradient.ndim - 1)
        mask, index = active.view(shape), (counts + 1).clamp(max=len(self._corrections) - 1)
        rate, root = (column.view(shape) for column in self._corrections[index].unbind(dim=1))
        mean = torch.lerp(self.mean, gradient, 1 - BETAS[0])
        square = torch.addcmul(self.square * BETAS[1], gradient, gradient, value=1 - BETAS[1])
        change = mean / (square.sqrt() / root + self._epsilon) * rate
        write_masked(self.mean, mean, mask)
        write_masked(self.square, square, mask)
        write_masked(self._parameters, self._parameters - change, mask)

    def row(self, slot: int, parameters: torch.Tensor) -> "RowAdam":
        """Return a view of this optimiser, sharing its memory, restricted to the run in `slot`.

        `parameters` (1, ..., p) are the row of that slot as a leaf of autograd.
        """
        one = slice(slot, slot + 1)
        optimiser = torch.optim.Adam([parameters], self._rate, BETAS, self._epsilon, fused=True)
        return RowAdam(optimiser, parameters, self.mean[one], self.square[one])


class RowAdam(StackedAdam):
    """Adam for one run of a stack with torch's fused kernel, on a CPU six times as fast as `StackedAdam`."""

    def __init__(
        self, optimiser: torch.optim.Adam, parameters: torch.Tensor, mean: torch.Tensor, square: torch.Tensor
    ) -> None:
        self._optimiser, self._parameters, self.mean, self.square = optimiser, parameters, mean, square
        self._count = torch.zeros((), dtype=torch.float32)
        optimiser.state[parameters] = {"step": self._count, "exp_avg": mean, "exp_avg_sq": square}

    def step(self, gradient: torch.Tensor, counts: torch.Tensor, active: torch.Tensor) -> None:  # noqa: ARG002
        """Take one optimiser step for the run, as in `StackedAdam.step`."""
        self._count.copy_(counts[0])
        self._parameters.grad = gradient
        take_step(self._optimiser)


def write_masked(memory: torch.Tensor, values: torch.Tensor, mask: torch.Tensor) -> None:
    """Write `values` to `memory` where the broadcast `mask` is True."""
    memory.copy_(torch.where(mask, values, memory))


def _corrections(rate: float) -> list[tuple[float, float]]:
    """Return Adam's bias corrections rate / (1 - beta_1^t) and sqrt(1 - beta_2^t) for t = 0, 1, ..."""
    last = math.ceil(math.log(2.0**-54) / math.log(max(BETAS)))
    first, second = BETAS
    powers = ((first**step, second**step) for step in range(1, last + 1))
    return [(0.0, 1.0), *((rate / (1 - mean), math.sqrt(1 - square)) for mean, square in powers)]
