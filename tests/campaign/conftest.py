"""A real Ray on this machine, kept apart from the user's files and from other clusters."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tma_ray.campaign.cluster import connect

HELPERS = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "runs")]
sys.path.insert(0, HELPERS[1])  # worlds and run helpers are shared with the tests of runs


@pytest.fixture(scope="session")
def cluster() -> Iterator[None]:
    import ray

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join(HELPERS), prepend=os.pathsep)  # workers inherit it
        connect(None)
    yield
    ray.shutdown()
