"""Multilayer perceptrons with flat parameters, single or stacked: forward pass, gradients and Adam."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from tma_ray.students.mlp.layout import Activation, Layout
from tma_ray.support.import_hacks import take_step

Layers: TypeAlias = Sequence[tuple[torch.Tensor, torch.Tensor]]
"""Weight (outputs, inputs) and bias (outputs,) of every layer; (k, ...) for k stacked networks."""

Buffers: TypeAlias = Callable[[int, torch.Tensor], torch.Tensor]
"""Function of a layer's index and inputs (n, ...) that returns memory (n, h) for its outputs."""


def split(parameters: torch.Tensor, layout: Layout) -> Layers:
    """Return the layers in `parameters` (p,) or (k, p) as views."""
    vectors = torch.split(parameters, layout.lengths, dim=-1)
    leading, shapes = parameters.shape[:-1], zip(vectors[::2], layout.shapes, strict=True)
    weights = [vector.view(*leading, *shape) for vector, shape in shapes]
    return list(zip(weights, vectors[1::2], strict=True))


def activations(
    layers: Layers,
    inputs: torch.Tensor,
    activation: Activation = Activation.RELU,
    buffers: Buffers | None = None,
) -> list[torch.Tensor]:
    """Return the inputs of each layer and the final outputs, each (n, ...) or (k, n, ...).

    Autograd can differentiate them unless hidden outputs are written to `buffers`.
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
    """Return the outputs (n, h) or (k, n, h) for `inputs` (n, i) or (k, n, i)."""
    return activations(layers, inputs, activation)[-1]


def activate(outputs: torch.Tensor, activation: Activation) -> torch.Tensor:
    """Apply the `activation` to a layer's `outputs` in place and return them."""
    return outputs.relu_() if activation is Activation.RELU else outputs.tanh_()


class Network:
    """Multilayer perceptron with a backward pass that is faster than autograd's.

    It equals `forward` over `split` up to rounding, but reuses the memory of hidden layers and skips rows
    without a gradient if only inputs need one, which saves a tenth of SAC's training step. Only the last of
    several passes can be differentiated (torch rejects the others).

    Args:
        parameters: shared memory of the parameters (p,).
        layout: layout of the network.
        gradient: memory of the parameters' gradient (p,), which each backward pass overwrites.

    Attributes:
        parameters: parameters as a leaf of autograd.
        layers: weights and biases as views of the parameters, without a gradient.
        layer_gradients: gradients of weights and biases as views of `gradient`.
    """

    def __init__(
        self, parameters: torch.Tensor, layout: Layout, gradient: torch.Tensor | None = None
    ) -> None:
        self.parameters = parameters.detach().requires_grad_()
        self._frozen = parameters.detach()
        self.layout = layout
        self.gradient = torch.zeros_like(self._frozen) if gradient is None else gradient
        # cached, since creating the views takes a hundredth of a training step
        self.layers = split(self._frozen, layout)
        self.layer_gradients = split(self.gradient, layout)
        self._memory: dict[tuple[str, int], torch.Tensor] = {}

    def activations(self, inputs: torch.Tensor) -> list[torch.Tensor]:
        """Return the inputs (n, ...) of every layer and the outputs (n, h), for `backpropagate`."""
        return activations(
            self.layers, inputs, self.layout.activation, lambda *layer: self._buffer("outputs", *layer)
        )

    def backpropagate(self, kept: Sequence[torch.Tensor], gradient: torch.Tensor) -> torch.Tensor:
        """Write the parameters' gradient and return the gradient of the first layer's outputs (n, h).

        Args:
            kept: inputs of every layer (n, ...).
            gradient: gradient of the loss with respect to the outputs (n, h).
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
        """Return the outputs (n, h) for `inputs` (n, i), differentiable in inputs and parameters."""
        outputs: torch.Tensor = _lean_pass(inputs, self.parameters, self)
        return outputs

    def frozen(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return the outputs (n, h) for `inputs` (n, i), differentiable in the inputs only."""
        outputs: torch.Tensor = _lean_pass(inputs, self._frozen, self)
        return outputs

    def _buffer(self, use: str, index: int, like: torch.Tensor) -> torch.Tensor:
        """Return the cached buffer (n, h) of hidden layer `index` for the purpose `use`; n as in `like`."""
        shape = len(like), self.layout.sizes[index + 1]
        memory = self._memory.get((use, index))
        if memory is None or memory.shape != shape:
            memory = self._memory[use, index] = like.new_empty(shape)
        return memory


class _LeanPass(torch.autograd.Function):
    """Autograd function that applies a `Network`."""

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
    """Return the gradient with respect to a network's inputs (n, i), skipping rows of zero gradient.

    Args:
        layers: layers of the network.
        kept: inputs of every layer (n, ...).
        gradient: gradient of the loss with respect to the outputs (n, h).
        activation: activation of the hidden layers.
    """
    result = torch.zeros_like(kept[0])
    rows = gradient.any(dim=1).nonzero()[:, 0]
    gradient = gradient[rows]
    for (weight, _), values in zip(reversed(layers[1:]), reversed(kept[1:]), strict=True):
        gradient = _through(torch.mm(gradient, weight), values[rows], activation)
    result[rows] = torch.mm(gradient, layers[0][0])
    return result


def _through(gradient: torch.Tensor, outputs: torch.Tensor, activation: Activation) -> torch.Tensor:
    """Multiply `gradient` in place by the derivative of `activation`, given the activation's `outputs`."""
    if activation is Activation.TANH:
        torch.ops.aten.tanh_backward.grad_input(gradient, outputs, grad_input=gradient)
    else:
        torch.ops.aten.threshold_backward.grad_input(gradient, outputs, 0, grad_input=gradient)
    return gradient


def as_batch(observations: NDArray[np.float32], device: torch.device) -> torch.Tensor:
    """Return `observations` (o,) or (n, o) as a tensor (1, o) or (n, o) on `device`."""
    rows = torch.from_numpy(np.asarray(observations, dtype=np.float32))
    return (rows if rows.ndim == 2 else rows[None]).to(device)


Blocks: TypeAlias = Sequence[Sequence[nn.Linear]]
"""Blocks of layers in order. Layers of one block share inputs, and their outputs are concatenated."""


def blocks_of(module: nn.Module, *heads: nn.Module) -> Blocks:
    """Return the linear layers of `module` in order, followed by `heads` as one block."""
    blocks: list[Sequence[nn.Linear]] = [[part] for part in module.modules() if isinstance(part, nn.Linear)]
    if heads:
        blocks.append([head for head in heads if isinstance(head, nn.Linear)])
        assert len(blocks[-1]) == len(heads)
    return blocks


MODULES: Mapping[Activation, type[nn.Module]] = {Activation.RELU: nn.ReLU, Activation.TANH: nn.Tanh}
"""Module class of each activation."""


class FlatParameters:
    """Parameters of modules, moved to one flat vector; the modules' parameters become views of it.

    Attributes:
        parameters: parameters of the modules in the order of the vector.
        values: the vector (p,).
        gradient: gradient of the vector (p,), which `differentiate` writes.
        networks: networks over parts of the vector.
        others: values of `others` as leaves of autograd.
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
        for blocks in networks:
            units = [sum(layer.out_features for layer in block) for block in blocks]
            layout = Layout((blocks[0][0].in_features, *units), activation)
            part = slice(start, start + layout.parameters)
            self.networks.append(Network(self.values[part], layout, self.gradient[part]))
            start = part.stop
        self.others = [parameter.detach().requires_grad_() for parameter in others]
        self._others_gradient = self.views(self.gradient)[len(self.parameters) - len(others) :]

    def views(self, buffer: torch.Tensor) -> list[torch.Tensor]:
        """Return views of `buffer` (p,) with the shapes of the parameters."""
        vectors = torch.split(buffer, [parameter.numel() for parameter in self.parameters])
        return [vector.view_as(like) for vector, like in zip(vectors, self.parameters, strict=True)]

    def differentiate(self, loss: torch.Tensor) -> None:
        """Write the gradient of `loss` with respect to `networks` and `others` to `gradient`."""
        leaves = [network.parameters for network in self.networks]
        others = torch.autograd.grad(loss, [*leaves, *self.others])[len(leaves) :]
        self._keep(others)

    def backpropagate(
        self, kept: Sequence[torch.Tensor], gradient: torch.Tensor, others: Sequence[torch.Tensor] = ()
    ) -> None:
        """Backpropagate the `gradient` (n, h) of the outputs through the only network.

        The results and `others`, the gradients of the other parameters, are written to `self.gradient`.
        """
        (network,) = self.networks
        network.backpropagate(kept, gradient)
        self._keep(others)

    def _keep(self, others: Sequence[torch.Tensor]) -> None:
        for memory, gradient in zip(self._others_gradient, others, strict=True):
            memory.copy_(gradient)


def as_modules(parameters: torch.Tensor, layout: Layout) -> list[nn.Module]:
    """Return linear layers with `parameters` (p,), and the activations between them."""
    modules: list[nn.Module] = []
    for weight, bias in split(parameters, layout):
        layer = nn.Linear(weight.shape[1], weight.shape[0], device="meta")  # skips initialisation
        layer.weight, layer.bias = (nn.Parameter(x, requires_grad=False) for x in (weight, bias))
        modules += [layer, MODULES[layout.activation]()]
    return modules[:-1]


class FlatAdam:
    """Adam on a flat vector; its state is shared with `optimiser`, which checkpoints save."""

    def __init__(self, optimiser: torch.optim.Optimizer, flat: FlatParameters) -> None:
        (group,) = optimiser.param_groups
        assert isinstance(optimiser, torch.optim.Adam)
        assert set(map(id, group["params"])) == set(map(id, flat.parameters))
        self._optimiser, self._flat = optimiser, flat
        flat.values.grad = flat.gradient
        settings = {key: group[key] for key in ("lr", "betas", "eps", "weight_decay")}
        self._adam = torch.optim.Adam([flat.values], fused=True, **settings)
        self._mean, self._square = torch.zeros_like(flat.values), torch.zeros_like(flat.values)
        # one step count per parameter tensor, as in torch's Adam
        self._steps = torch.zeros(len(flat.parameters), dtype=torch.float32)
        loaded = optimiser.state
        if loaded:
            for name, buffer in (("exp_avg", self._mean), ("exp_avg_sq", self._square)):
                torch.cat([loaded[parameter][name].reshape(-1) for parameter in flat.parameters], out=buffer)
            self._share(float(loaded[flat.parameters[0]]["step"]))

    def step(self) -> None:
        """Take one optimiser step with `flat.gradient`."""
        if not self._optimiser.state:
            self._share(0.0)
        take_step(self._adam)
        self._steps += 1

    @property
    def moments(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Running means of the gradient and of its square (p,), zeros before the first step."""
        return self._mean, self._square

    @property
    def steps(self) -> int:
        """Number of steps taken."""
        return int(self._steps[0])

    def put(self, mean: torch.Tensor, square: torch.Tensor, steps: int) -> None:
        """Load the moments (p,) and the number of steps of another optimiser."""
        self._mean.copy_(mean)
        self._square.copy_(square)
        if steps:
            self._share(float(steps))
        else:
            self._optimiser.state.clear()

    def _share(self, steps: float) -> None:
        """Set the number of steps, and make the states of both optimisers views of the same memory."""
        self._steps.fill_(steps)
        views = self._flat.views(self._mean), self._flat.views(self._square)
        for parameter, step, mean, square in zip(self._flat.parameters, self._steps, *views, strict=True):
            self._optimiser.state[parameter] = {"step": step, "exp_avg": mean, "exp_avg_sq": square}
        self._adam.state[self._flat.values] = {
            "step": torch.tensor(steps, dtype=torch.float32, device=self._flat.values.device),
            "exp_avg": self._mean,
            "exp_avg_sq": self._square,
        }
