"""Every teacher of the catalogue, on task spaces of many shapes."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from simulated_play import SPACES
from threadpoolctl import threadpool_limits

from tma_ray.tasks import TaskSpace
from tma_ray.teachers import TEACHERS


@pytest.fixture(params=SPACES)
def space(request: pytest.FixtureRequest) -> TaskSpace:
    return SPACES[request.param]


@pytest.fixture(params=TEACHERS.names())
def teacher_name(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="session", autouse=True)
def single_thread() -> Iterator[None]:
    """Tiny matrices on many threads cost far more than they save where other processes are busy, too."""
    with threadpool_limits(limits=1):
        yield
