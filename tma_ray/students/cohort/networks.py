"""Forward passes of stacked networks over padded flat parameters, differentiable by autograd."""

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
    """A layout of which inputs and hidden layers are padded; outputs are not.

    Attributes:
        plain: layout without padding.
        padded: layout with padding.
        others: number of parameters that follow the network's.
    """

    plain: Layout
    padded: Layout
    others: int = 0

    @classmethod
    def of(cls, plain: Layout, others: int = 0) -> "PaddedLayout":
        """Return the padding of `plain`, after whose parameters there are `others`."""
        inputs, *hidden, outputs = plain.sizes
        sizes = [_up(inputs, INPUTS_MULTIPLE), *(_up(size, HIDDEN_MULTIPLE) for size in hidden), outputs]
        return cls(plain, Layout(tuple(sizes), plain.activation), others)

    @property
    def length(self) -> int:
        """Number of parameters with padding, at the end too."""
        return _up(self.padded.parameters + self.others, HIDDEN_MULTIPLE)

    def places(self) -> NDArray[np.int64]:
        """Return the index of each parameter of the plain vector (p,) in the padded one."""
        parts, start = [], 0
        for (outputs, inputs), padded in zip(self.plain.shapes, self.padded.shapes, strict=True):
            weights = start + np.arange(math.prod(padded)).reshape(padded)
            biases = start + weights.size
            parts += [weights[:outputs, :inputs].ravel(), np.arange(biases, biases + outputs)]
            start = biases + padded[0]
        return np.concatenate([*parts, np.arange(start, start + self.others)])

    def inputs(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return `inputs` (..., i) with zeros behind, as many as are missing."""
        missing = self.padded.sizes[0] - inputs.shape[-1]
        return torch.nn.functional.pad(inputs, (0, missing)) if missing else inputs


def _up(size: int, multiple: int) -> int:
    return -(-size // multiple) * multiple


def stacked_pass(
    parameters: torch.Tensor, layout: PaddedLayout, inputs: torch.Tensor, hidden: torch.dtype
) -> torch.Tensor:
    """Return the outputs (k, n, h) of k networks.

    Args:
        parameters: padded (k, p).
        layout: layout of each network.
        inputs: values without padding (k, n, i).
        hidden: type in which hidden layers are computed; the last layer is in that of the parameters.
    """
    layers, activation = _layers(parameters, layout), layout.padded.activation
    # leaving rows out pays: not on a GPU, which would be waited for, nor in compiled code
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
    """Return the values (k, n, 2) of k pairs of critics with `parameters` (k, 2, p); see `stacked_pass`."""
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


def _layers(parameters: torch.Tensor, layout: PaddedLayout) -> Layers:
    return split(parameters[:, : layout.padded.parameters], layout.padded)


BETAS = 0.9, 0.999


class StackedAdam:
    """Adam as in `torch.optim.Adam`, with a step count for each run.

    Args:
        parameters: parameters of all runs (k, ..., p), which `step` changes.
        rate: step size.
        epsilon: added to the root of the mean square.

    Attributes:
        mean: running mean of the gradient, with the shape of the parameters.
        square: running mean of the squared gradient, with the same shape.
    """

    def __init__(self, parameters: torch.Tensor, rate: float, epsilon: float = 1e-8) -> None:
        self._parameters, self._rate, self._epsilon = parameters, rate, epsilon
        self.mean, self.square = torch.zeros_like(parameters), torch.zeros_like(parameters)
        # computed once, on the host: powers would be rounded differently from device to device
        self._corrections = torch.tensor(_corrections(rate), dtype=parameters.dtype, device=parameters.device)

    def step(self, gradient: torch.Tensor, counts: torch.Tensor, active: torch.Tensor) -> None:
        """Move the parameters of the `active` runs (k,) against `gradient`; others' do not change by a bit.

        `counts` are the steps of each run before this one (k,).
        """
        aside = len(active), *[1] * (gradient.ndim - 1)
        mask, index = active.view(aside), (counts + 1).clamp(max=len(self._corrections) - 1)
        rate, root = (part.view(aside) for part in self._corrections[index].unbind(dim=1))
        mean = torch.lerp(self.mean, gradient, 1 - BETAS[0])
        square = torch.addcmul(self.square * BETAS[1], gradient, gradient, value=1 - BETAS[1])
        change = mean / (square.sqrt() / root + self._epsilon) * rate
        keep(self.mean, mean, mask)
        keep(self.square, square, mask)
        keep(self._parameters, self._parameters - change, mask)

    def row(self, slot: int, parameters: torch.Tensor) -> "RowAdam":
        """Return the optimiser of the run in `slot` alone, over the same moments.

        `parameters` (1, ..., p), a leaf of autograd, are the same memory as the row of that slot.
        """
        one = slice(slot, slot + 1)
        optimiser = torch.optim.Adam([parameters], self._rate, BETAS, self._epsilon, fused=True)
        return RowAdam(optimiser, parameters, self.mean[one], self.square[one])


class RowAdam(StackedAdam):
    """Adam for one run of a stack by torch's fused kernel, which takes a processor a sixth of the time.

    Its parameters (1, ..., p) and moments are the stack's memory.
    """

    def __init__(
        self, optimiser: torch.optim.Adam, parameters: torch.Tensor, mean: torch.Tensor, square: torch.Tensor
    ) -> None:
        self._optimiser, self._parameters, self.mean, self.square = optimiser, parameters, mean, square
        self._count = torch.zeros((), dtype=torch.float32)
        optimiser.state[parameters] = {"step": self._count, "exp_avg": mean, "exp_avg_sq": square}

    def step(self, gradient: torch.Tensor, counts: torch.Tensor, active: torch.Tensor) -> None:  # noqa: ARG002
        """Move the parameters of the run, which is active; see `StackedAdam.step`."""
        self._count.copy_(counts[0])
        self._parameters.grad = gradient
        take_step(self._optimiser)


def keep(memory: torch.Tensor, values: torch.Tensor, mask: torch.Tensor) -> None:
    """Write `values` to `memory` where the `mask`, which broadcasts to them, is True."""
    memory.copy_(torch.where(mask, values, memory))


def _corrections(rate: float) -> list[tuple[float, float]]:
    """Return rate / (1 - beta_1^t) and sqrt(1 - beta_2^t) for t = 0, 1, ... until they stay the same."""
    last = math.ceil(math.log(2.0**-54) / math.log(max(BETAS)))
    first, second = BETAS
    powers = ((first**step, second**step) for step in range(1, last + 1))
    return [(0.0, 1.0), *((rate / (1 - one), math.sqrt(1 - two)) for one, two in powers)]
