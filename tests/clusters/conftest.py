"""Marks and fixtures of tests on a bed of virtual machines, which need root on Linux."""

import subprocess
import sys
from pathlib import Path

import pytest
from bed import REPOSITORY, missing

FOLDER = Path(__file__).parent


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark all tests of this folder, and skip them if this machine cannot have a bed."""
    reason = missing()
    for item in items:
        if FOLDER in item.path.parents:
            item.add_marker(pytest.mark.clusters)
            if reason:
                item.add_marker(pytest.mark.skip(reason=reason))


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Wheel built from this checkout."""
    folder = tmp_path_factory.mktemp("dist")
    build = [sys.executable, "-m", "build", "--wheel", "--outdir", str(folder), str(REPOSITORY)]
    subprocess.run(build, check=True, stdout=subprocess.DEVNULL)
    (built,) = folder.glob("*.whl")
    return built
