"""Where a campaign's own Ray puts its files."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from tma_ray.campaign.cluster.local import private_folder


@pytest.fixture(autouse=True)
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.delenv("RAY_TMPDIR", raising=False)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return tmp_path


def test_is_of_the_user_alone_and_the_same_each_time(temporary: Path) -> None:
    folder = private_folder()
    assert folder is not None
    assert folder == str(temporary / f"tma_ray-{os.getuid()}")
    assert stat.S_IMODE(Path(folder).stat().st_mode) == 0o700
    assert private_folder() == folder


@pytest.mark.parametrize("trap", ["open", "link"])
def test_a_folder_that_others_may_have_made_is_not_used(temporary: Path, trap: str) -> None:
    place = temporary / f"tma_ray-{os.getuid()}"
    if trap == "open":
        place.mkdir()
        place.chmod(0o777)
    else:
        place.symlink_to(temporary)
    folder = private_folder()
    assert folder is not None
    assert folder != str(place)
    assert stat.S_IMODE(Path(folder).stat().st_mode) == 0o700


def test_what_the_user_chooses_is_left_to_ray(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RAY_TMPDIR", "/somewhere")
    assert private_folder() is None
