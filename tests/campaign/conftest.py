"""Fixture of a Ray cluster on this machine, isolated from other clusters and the user's files."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from tma_ray.campaign.cluster.connection import connect

HELPERS = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "runs")]
"""Import paths of workers; those of this process are in pyproject.toml."""


@pytest.fixture(scope="session")
def cluster() -> Iterator[None]:
    import ray

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join(HELPERS), prepend=os.pathsep)  # workers inherit it
        patch.setenv("RAY_worker_niceness", "0")  # with the default, parallel tests starve the workers
        connect(None)
    yield
    ray.shutdown()
