"""Optimisers of torch, used without its compiler, compute what they always did."""

from __future__ import annotations

import copy

import pytest
import torch

from tma_ray.optimisers import leave_compiler_out, take_step

leave_compiler_out()


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
