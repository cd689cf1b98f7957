"""Fixture that seeds torch's global generator."""

from collections.abc import Iterator

import pytest
import torch


@pytest.fixture
def _seeded() -> Iterator[None]:
    with torch.random.fork_rng():
        torch.manual_seed(4)
        yield
