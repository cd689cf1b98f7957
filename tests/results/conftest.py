import shutil
from pathlib import Path

import pytest
from obstore.store import MemoryStore
from results_examples import OLD_ROOT, make_record

from tma_ray.results import RunRecord, Store
from tma_ray.results.storage import BucketStore


@pytest.fixture(params=["local", *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("memory", "s3"))])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Store:
    """Store on a disk, in a bucket in memory, or in a bucket of a server."""
    if request.param == "local":
        return Store.open(tmp_path / "root")
    if request.param == "s3":
        return Store.open(request.getfixturevalue("s3_root"))
    return BucketStore(MemoryStore(), "s3://bucket/root")


@pytest.fixture
def record() -> RunRecord:
    return make_record("run-1")


@pytest.fixture
def old_root(tmp_path: Path) -> Path:
    """Copy of a root written by the first version."""
    return Path(shutil.copytree(OLD_ROOT, tmp_path / "root"))
