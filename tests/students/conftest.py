"""A seed of torch's own generator for tests that draw from it."""

from collections.abc import Iterator

import pytest
import torch


@pytest.fixture
def _seeded() -> Iterator[None]:
    with torch.random.fork_rng():
        torch.manual_seed(4)
        yield
