from pathlib import Path

import pytest
from pyarrow import fs
from results_examples import make_record

from tma_ray.results import RunRecord, Store


@pytest.fixture(params=["local", "memory"])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Store:
    """A store on a disk, and one that only knows pyarrow's file system interface."""
    if request.param == "local":
        return Store.open(tmp_path / "root")
    return Store(fs._MockFileSystem(), "bucket/root")


@pytest.fixture
def record() -> RunRecord:
    return make_record("run-1")
