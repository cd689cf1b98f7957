from pathlib import Path

import pytest
from pyarrow import fs
from results_examples import make_record

from tma_ray.results import RunRecord, Store


@pytest.fixture(params=["local", *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("memory", "s3"))])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Store:
    """A store on a disk, one that only knows pyarrow's file system interface, and one in a bucket."""
    if request.param == "local":
        return Store.open(tmp_path / "root")
    if request.param == "s3":
        return Store.open(request.getfixturevalue("s3_root"))
    return Store(fs._MockFileSystem(), "bucket/root")


@pytest.fixture
def record() -> RunRecord:
    return make_record("run-1")
