"""Fixture that limits tests of teachers to one thread."""

from collections.abc import Iterator

import pytest
from threadpoolctl import threadpool_limits


@pytest.fixture(scope="module", autouse=True)
def single_thread() -> Iterator[None]:
    """Limit matrix products to one thread, since more are slower on tiny matrices in parallel tests."""
    with threadpool_limits(limits=1):
        yield
