"""One thread for all tests of teachers."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from threadpoolctl import threadpool_limits


@pytest.fixture(scope="module", autouse=True)
def single_thread() -> Iterator[None]:
    """Tiny matrices on many threads cost far more than they save where other processes are busy, too."""
    with threadpool_limits(limits=1):
        yield
