"""Forward pass of a multilayer perceptron over flat parameters, of one network or of several stacked."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray

from tma_ray.students.mlp.layout import Activation, Layout

Layers: TypeAlias = Sequence[tuple[torch.Tensor, torch.Tensor]]
"""Weight (outputs, inputs) and bias (outputs,) of every layer in order; of k stacked networks (k, ...)."""

Buffers: TypeAlias = Callable[[int, torch.Tensor], torch.Tensor]
"""Memory (n, h) for the outputs of a layer, by its index, given one of its inputs (n, ...)."""


def split(parameters: torch.Tensor, layout: Layout) -> Layers:
    """Returns the layers in `parameters` (p,) or (k, p), as views."""
    parts = torch.split(parameters, layout.lengths, dim=-1)
    leading = parameters.shape[:-1]
    weights = [part.view(*leading, *shape) for part, shape in zip(parts[::2], layout.shapes, strict=True)]
    return list(zip(weights, parts[1::2], strict=True))


def activations(
    layers: Layers,
    inputs: torch.Tensor,
    activation: Activation = Activation.RELU,
    buffers: Buffers | None = None,
) -> list[torch.Tensor]:
    """Returns the inputs of every layer, and at the end the outputs of the last: (n, ...) or (k, n, ...).

    Differentiable by autograd, if without `buffers`.

    Args:
        layers: of one network or of k.
        inputs: (n, i), or of k networks (k, n, i).
        activation: function after each layer but the last.
        buffers: where hidden layers' outputs are written; by default in new memory.
    """
    values = [inputs]
    for index, (weight, bias) in enumerate(layers):
        is_hidden = index < len(layers) - 1
        out = buffers(index, inputs) if buffers and is_hidden else None
        if weight.ndim == 2:
            outputs = torch.addmm(bias, values[-1], weight.t(), out=out)
        else:
            outputs = torch.baddbmm(bias[:, None], values[-1], weight.mT, out=out)
        values.append(activate(outputs, activation) if is_hidden else outputs)
    return values


def forward(layers: Layers, inputs: torch.Tensor, activation: Activation = Activation.RELU) -> torch.Tensor:
    """Returns the outputs (n, h) or (k, n, h); arguments as for `activations`."""
    return activations(layers, inputs, activation)[-1]


def activate(outputs: torch.Tensor, activation: Activation) -> torch.Tensor:
    """Returns the `activation` of a layer's `outputs`, in place."""
    return outputs.relu_() if activation is Activation.RELU else outputs.tanh_()


class Network:
    """A network that is trained alone, with a backward pass that is leaner than autograd's.

    Equal to `forward` over `split` up to rounding. Memory of hidden layers is kept from pass to pass,
    since new pages cost time; where no parameter needs a gradient, rows without one are left out.
    Together that is a tenth of SAC's training step. Of several passes only the last can be
    differentiated: torch refuses the others.

    Args:
        parameters: (p,); a view, so that it is always the present ones that are applied.
        layout: of the network.
        gradient: memory for the parameters' gradient (p,), which each backward pass overwrites.

    Attributes:
        parameters: the same memory, as a leaf of autograd.
        gradient: likewise.
        layers: weights and biases, as views of the parameters without a gradient.
        layer_gradients: views of `gradient`, likewise.
    """

    def __init__(
        self, parameters: torch.Tensor, layout: Layout, gradient: torch.Tensor | None = None
    ) -> None:
        self.parameters = parameters.detach().requires_grad_()
        self._frozen = parameters.detach()
        self.layout = layout
        self.gradient = torch.zeros_like(self._frozen) if gradient is None else gradient
        # views of fixed memory, made once: making them at every pass is a hundredth of a training step
        self.layers = split(self._frozen, layout)
        self.layer_gradients = split(self.gradient, layout)
        self._memory: dict[tuple[str, int], torch.Tensor] = {}

    def activations(self, inputs: torch.Tensor) -> list[torch.Tensor]:
        """Returns the inputs (n, ...) of every layer and the outputs (n, h), for `backpropagate`."""
        return activations(
            self.layers, inputs, self.layout.activation, lambda *where: self._buffer("outputs", *where)
        )

    def backpropagate(self, kept: Sequence[torch.Tensor], gradient: torch.Tensor) -> torch.Tensor:
        """Writes the parameters' gradient.

        Args:
            kept: the inputs of every layer in the last forward pass.
            gradient: of the loss by the outputs (n, h).

        Returns:
            The loss's gradient by the first layer's outputs (n, h), which the next pass overwrites.
        """
        for index in range(len(self.layers) - 1, -1, -1):
            weight_gradient, bias_gradient = self.layer_gradients[index]
            torch.mm(gradient.t(), kept[index], out=weight_gradient)
            torch.sum(gradient, dim=0, out=bias_gradient)
            if index:
                out = self._buffer("gradient", index - 1, gradient)
                gradient = torch.mm(gradient, self.layers[index][0], out=out)
                gradient = _through(gradient, kept[index], self.layout.activation)
        return gradient

    def __call__(self, inputs: torch.Tensor) -> torch.Tensor:
        """Returns the outputs (n, h) for `inputs` (n, i), to be differentiated by both."""
        outputs: torch.Tensor = _lean_pass(inputs, self.parameters, self)
        return outputs

    def frozen(self, inputs: torch.Tensor) -> torch.Tensor:
        """Returns the outputs (n, h) for `inputs` (n, i), to be differentiated by the inputs only."""
        outputs: torch.Tensor = _lean_pass(inputs, self._frozen, self)
        return outputs

    def _buffer(self, use: str, index: int, like: torch.Tensor) -> torch.Tensor:
        """Returns memory (n, h) for hidden layer `index`, kept for each `use`; n as in `like`."""
        shape = len(like), self.layout.sizes[index + 1]
        memory = self._memory.get((use, index))
        if memory is None or memory.shape != shape:
            memory = self._memory[use, index] = like.new_empty(shape)
        return memory


class _LeanPass(torch.autograd.Function):
    """Forward and backward pass of a `Network`, for autograd."""

    @staticmethod
    def forward(ctx: Any, inputs: torch.Tensor, parameters: torch.Tensor, network: Network) -> torch.Tensor:
        *kept, outputs = network.activations(inputs)
        ctx.network = network
        ctx.save_for_backward(parameters, *kept)
        return outputs

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor | None, torch.Tensor | None, None]:
        (gradient,), (_, *kept) = gradients, ctx.saved_tensors
        wants_inputs, wants_parameters, _ = ctx.needs_input_grad
        network = ctx.network
        if not wants_parameters:
            return input_gradient(network.layers, kept, gradient, network.layout.activation), None, None
        gradient = network.backpropagate(kept, gradient)
        by_inputs = torch.mm(gradient, network.layers[0][0]) if wants_inputs else None
        return by_inputs, network.gradient, None


_lean_pass: Any = _LeanPass.apply


def input_gradient(
    layers: Layers, kept: Sequence[torch.Tensor], gradient: torch.Tensor, activation: Activation
) -> torch.Tensor:
    """Returns the loss's gradient by a network's inputs (n, i), computed for the rows that have one.

    Args:
        layers: of one network.
        kept: the inputs of every layer (n, ...).
        gradient: of the loss by the outputs (n, h).
        activation: function after each layer but the last.
    """
    result = torch.zeros_like(kept[0])
    rows = gradient.any(dim=1).nonzero()[:, 0]
    gradient = gradient[rows]
    for (weight, _), values in zip(reversed(layers[1:]), reversed(kept[1:]), strict=True):
        gradient = _through(torch.mm(gradient, weight), values[rows], activation)
    result[rows] = torch.mm(gradient, layers[0][0])
    return result


def _through(gradient: torch.Tensor, outputs: torch.Tensor, activation: Activation) -> torch.Tensor:
    """Returns `gradient`, in place, times the derivative of the activation, given its `outputs`."""
    through: torch.Tensor
    if activation is Activation.TANH:
        through = torch.ops.aten.tanh_backward.grad_input(gradient, outputs, grad_input=gradient)
        return through
    through = torch.ops.aten.threshold_backward.grad_input(gradient, outputs, 0, grad_input=gradient)
    return through


def as_batch(observations: NDArray[np.float32], device: torch.device) -> torch.Tensor:
    """Returns `observations` (o,) or (n, o) as a tensor (1, o) or (n, o) on `device`."""
    rows = torch.from_numpy(np.asarray(observations, dtype=np.float32))
    return (rows if rows.ndim == 2 else rows[None]).to(device)
