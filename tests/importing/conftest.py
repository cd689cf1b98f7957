import os
from pathlib import Path

import pytest
from release_folders import Release


@pytest.fixture(autouse=True)
def _no_waiting_for_disks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether roots survive a power cut is tested elsewhere."""
    monkeypatch.setattr(os, "fsync", lambda _: None)


@pytest.fixture
def release(tmp_path: Path) -> Release:
    return Release(tmp_path / "release")
