"""Every teacher of the catalogue, on task spaces of many shapes."""

from __future__ import annotations

import pytest
from simulated_play import SPACES

from tma_ray.tasks import TaskSpace
from tma_ray.teachers import TEACHERS


@pytest.fixture(params=SPACES)
def space(request: pytest.FixtureRequest) -> TaskSpace:
    return SPACES[request.param]


@pytest.fixture(params=TEACHERS.names())
def teacher_name(request: pytest.FixtureRequest) -> str:
    return request.param
