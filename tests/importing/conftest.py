from pathlib import Path

import pytest
from release_folders import Release


@pytest.fixture
def release(tmp_path: Path) -> Release:
    return Release(tmp_path / "release")
