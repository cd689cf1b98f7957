"""What teachers do with torch leaves no trace in the process."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import torch
from simulated_play import SPACES, play, started

NETWORK_TEACHERS = ["goal_gan", "setter_solver"]


@pytest.fixture
def unusual_torch() -> Iterator[None]:
    threads, dtype, grad = torch.get_num_threads(), torch.get_default_dtype(), torch.is_grad_enabled()
    torch.set_num_threads(2)
    torch.set_default_dtype(torch.float64)
    torch.set_grad_enabled(False)
    torch.manual_seed(123)
    yield
    torch.set_num_threads(threads)
    torch.set_default_dtype(dtype)
    torch.set_grad_enabled(grad)


@pytest.mark.parametrize("name", NETWORK_TEACHERS)
def test_the_global_state_is_neither_used_nor_changed(name: str, request: pytest.FixtureRequest) -> None:
    expected = np.stack(play(started(name, SPACES["stump_tracks"]), 250))
    request.getfixturevalue("unusual_torch")
    before = torch.get_rng_state()
    teacher = started(name, SPACES["stump_tracks"])
    np.testing.assert_array_equal(np.stack(play(teacher, 250)), expected)
    teacher.probe(10)
    assert torch.equal(torch.get_rng_state(), before)
    assert torch.get_num_threads() == 2
    assert torch.get_default_dtype() is torch.float64
    assert not torch.is_grad_enabled()
