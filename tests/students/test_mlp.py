"""The multilayer perceptron: every way through it is the same function, and its gradients are autograd's."""

import copy

import numpy as np
import pytest
import torch
from torch import nn

from tma_ray.students.mlp.acting import ArrayNetwork, RowNetwork
from tma_ray.students.mlp.layout import Activation, Layout
from tma_ray.students.mlp.network import FlatParameters, Network, as_modules, blocks_of, forward, split
from tma_ray.support.import_hacks import skip_dynamo, take_step

pytestmark = pytest.mark.usefixtures("_seeded")
LAYOUTS = [Layout(sizes) for sizes in ((5, 7, 6, 3), (4, 2), (24, 40, 30, 8), (1, 9, 1))]
LAYOUTS.append(Layout((5, 7, 6, 3), Activation.TANH))
NAMES = ["-".join(map(str, (*layout.sizes, layout.activation))) for layout in LAYOUTS]
EACH = pytest.mark.parametrize("layout", LAYOUTS, ids=NAMES)


def drawn(layout: Layout, rows: int = 9) -> tuple[torch.Tensor, torch.Tensor]:
    """Return parameters (p,) and inputs (n, i) in float64."""
    parameters = torch.randn(layout.parameters, dtype=torch.float64) / max(layout.sizes) ** 0.5
    return parameters, torch.randn(rows, layout.sizes[0], dtype=torch.float64)


@EACH
def test_torchs_modules_stacks_and_compiled_rows_compute_the_same(layout):
    parameters, inputs = drawn(layout)
    expected = nn.Sequential(*as_modules(parameters, layout))(inputs)
    assert expected.shape == (9, layout.sizes[-1])
    found = forward(split(parameters, layout), inputs, layout.activation)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-12)
    torch.testing.assert_close(Network(parameters, layout)(inputs).detach(), expected, rtol=0, atol=1e-12)
    other = drawn(layout)
    layers = split(torch.stack([other[0], parameters]), layout)
    stacked = forward(layers, torch.stack([other[1], inputs]), layout.activation)
    torch.testing.assert_close(stacked[1], expected, rtol=0, atol=1e-12)
    row = RowNetwork(layout)
    row.load(parameters.numpy())
    outputs = np.stack([row(values) for values in inputs.float().numpy()])
    np.testing.assert_allclose(outputs, expected, atol=1e-5)
    arrays = ArrayNetwork(layout, layout.sizes[-1])
    arrays.load(parameters.float().numpy())
    np.testing.assert_allclose(arrays.outputs(inputs.float().numpy()), expected, atol=1e-5)


@EACH
def test_the_lean_backward_pass_equals_autograd(layout):
    parameters, inputs = drawn(layout)
    inputs.requires_grad_()
    outer = torch.randn(9, layout.sizes[-1], dtype=torch.float64)
    outer[[2, 5]] = 0  # rows without a gradient
    leaf = parameters.clone().requires_grad_()
    outputs = forward(split(leaf, layout), inputs, layout.activation)
    expected = torch.autograd.grad(outputs, (inputs, leaf), outer)
    network = Network(parameters, layout)
    found = torch.autograd.grad(network(inputs), (inputs, network.parameters), outer)
    for gradient, wanted in zip(found, expected, strict=True):
        torch.testing.assert_close(gradient, wanted, rtol=0, atol=1e-12)
    (by_inputs,) = torch.autograd.grad(network.frozen(inputs), inputs, outer)
    torch.testing.assert_close(by_inputs, expected[0], rtol=0, atol=1e-12)


def test_a_pass_that_was_followed_by_another_is_not_differentiated():
    network = Network(drawn(LAYOUTS[0])[0], LAYOUTS[0])
    inputs = drawn(LAYOUTS[0])[1]
    first = network(inputs).sum()
    network(inputs)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        first.backward()


def test_modules_are_views_of_the_vector_that_their_networks_apply():
    trunk = nn.Sequential(nn.Linear(5, 7), nn.ReLU(), nn.Linear(7, 6), nn.ReLU()).double()
    heads = nn.Linear(6, 2).double(), nn.Linear(6, 1).double()
    scale = nn.Parameter(torch.ones(4, dtype=torch.float64))
    flat = FlatParameters([blocks_of(trunk, *heads)], others=[scale])
    assert flat.values.shape == (LAYOUTS[0].parameters + 4,)
    inputs = drawn(LAYOUTS[0])[1]
    (network,) = flat.networks
    assert network.layout == LAYOUTS[0]
    for _ in range(2):
        expected = torch.cat([head(trunk(inputs)) for head in heads], dim=1)
        torch.testing.assert_close(network(inputs), expected, rtol=0, atol=1e-12)
        loss = expected.square().mean() + scale.square().sum()
        gradients = torch.autograd.grad(loss, flat.parameters)
        flat.differentiate(network(inputs).square().mean() + flat.others[0].square().sum())
        for found, wanted in zip(flat.views(flat.gradient), gradients, strict=True):
            torch.testing.assert_close(found, wanted, rtol=0, atol=1e-12)
        with torch.no_grad():
            flat.values.mul_(1.1)


def test_trunks_side_by_side_are_two_networks_that_share_their_inputs():
    layout = Layout((5, 8, 6, 3), Activation.TANH)
    parameters, inputs = drawn(layout)
    parameters *= torch.from_numpy(layout.trunks(2))
    outputs = forward(split(parameters, layout), inputs, layout.activation)
    (first, b1), (second, b2), (last, b3) = split(parameters, layout)
    for half, own in ((0, slice(2)), (1, slice(2, 3))):
        low, high = slice(4 * half, 4 * half + 4), slice(3 * half, 3 * half + 3)
        values = torch.tanh(inputs @ first[low].T + b1[low])
        values = torch.tanh(values @ second[high, low].T + b2[high])
        torch.testing.assert_close(outputs[:, own], values @ last[own, high].T + b3[own])
    assert layout.trunks(2).sum() == 2 * (5 * 4 + 4 + 4 * 3 + 3) + 3 * 3 + 3


skip_dynamo()


@pytest.mark.parametrize("kind", [torch.optim.Adam, torch.optim.RMSprop])
def test_a_step_is_torchs_own_bit_for_bit_also_after_loading(kind: type[torch.optim.Optimizer]) -> None:
    ours = torch.nn.Linear(5, 3)
    theirs = copy.deepcopy(ours)
    first, second = (kind(network.parameters(), lr=0.01) for network in (ours, theirs))
    inputs = torch.randn(8, 5)
    for step in range(6):
        if step == 3:
            first.load_state_dict(copy.deepcopy(second.state_dict()))
        for network, optimiser in ((ours, first), (theirs, second)):
            optimiser.zero_grad()
            network(inputs).square().sum().backward()
            take_step(optimiser) if optimiser is first else optimiser.step()
        for parameter, expected in zip(ours.parameters(), theirs.parameters(), strict=True):
            assert torch.equal(parameter, expected)
    assert float(first.state[ours.weight]["step"]) == 6
