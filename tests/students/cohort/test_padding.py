"""Padded layouts and the passes over them."""

import numpy as np
import torch

from tma_ray.students.cohort.networks import PaddedLayout, stacked_pass, twin_pass
from tma_ray.students.mlp.layout import Layout
from tma_ray.students.mlp.network import forward, split

PLAIN = Layout((5, 20, 9, 3))


def test_sizes_are_multiples_and_outputs_are_not_padded():
    layout = PaddedLayout.of(PLAIN, others=3)
    assert layout.padded.sizes == (8, 32, 16, 3)
    assert layout.length % 16 == 0
    places = layout.places()
    assert len(np.unique(places)) == len(places) == PLAIN.parameters + 3
    assert places.max() < layout.length
    assert PaddedLayout.of(Layout((24, 400, 300, 8))).padded.sizes == (24, 400, 304, 8)


def test_padded_networks_are_the_plain_ones():
    layout, generator = PaddedLayout.of(PLAIN), torch.Generator().manual_seed(0)
    plain = torch.randn(4, PLAIN.parameters, generator=generator, dtype=torch.float64)
    inputs = torch.randn(4, 6, 5, generator=generator, dtype=torch.float64)
    padded = torch.zeros(4, layout.length, dtype=torch.float64)
    padded[:, layout.places()] = plain
    expected = forward(split(plain, PLAIN), inputs)
    outputs = stacked_pass(padded.requires_grad_(), layout, inputs, torch.float64)
    torch.testing.assert_close(outputs, expected, rtol=1e-12, atol=1e-12)
    (gradient,) = torch.autograd.grad(outputs.square().sum(), padded)
    gradient[:, layout.places()] = 0
    assert not gradient.any()


def test_both_critics_of_a_pair_have_a_column_of_values():
    layout, generator = PaddedLayout.of(Layout((5, 16, 1))), torch.Generator().manual_seed(0)
    pairs = torch.randn(3, 2, layout.length, generator=generator)
    inputs = torch.randn(3, 6, 5, generator=generator)
    values = twin_pass(pairs, layout, inputs, torch.float32)
    assert values.shape == (3, 6, 2)
    for column in range(2):
        alone = stacked_pass(pairs[:, column], layout, inputs, torch.float32)
        torch.testing.assert_close(values[..., column], alone[..., 0])


def test_gradients_by_the_inputs_are_autograds_where_rows_without_one_are_left_out():
    layout, generator = PaddedLayout.of(Layout((5, 20, 9, 1))), torch.Generator().manual_seed(0)
    pairs = torch.zeros(3, 2, layout.length, dtype=torch.float64)
    pairs[..., layout.places()] = torch.randn(
        3, 2, layout.plain.parameters, generator=generator, dtype=torch.float64
    )
    inputs = torch.randn(3, 40, 5, generator=generator, dtype=torch.float64).requires_grad_()
    gradients = []
    for parameters in (pairs, pairs.clone().requires_grad_()):
        values = twin_pass(parameters, layout, inputs, torch.float64).min(dim=-1).values
        gradients += torch.autograd.grad(values.square().sum(), inputs)
    assert gradients[0].any(dim=-1).double().mean() > 0.9
    torch.testing.assert_close(*gradients, rtol=1e-12, atol=1e-12)
