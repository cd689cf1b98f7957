"""Where a campaign's own Ray puts its files, and what becomes of them."""

from __future__ import annotations

import stat
import subprocess
import sys
from pathlib import Path

import pytest

from tma_ray.campaign.cluster.heads import LONGEST_PLACE, MARK, private_folder


@pytest.fixture(autouse=True)
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A short one: sockets have to fit."""
    monkeypatch.delenv("RAY_TMPDIR", raising=False)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr("tma_ray.campaign.cluster.heads.LONGEST_PLACE", len(str(tmp_path)))
    return tmp_path


def abandoned(place: Path) -> Path:
    """Return the folder of a process that was killed."""
    code = (
        f"import os, tempfile; tempfile.tempdir = {str(place)!r}\n"
        "from tma_ray.campaign.cluster import heads\n"
        f"heads.LONGEST_PLACE = {len(str(place))}\n"
        "folder = heads.private_folder()\n"
        "(folder / 'ray' / 'logs').mkdir(parents=True)\n"
        "print(folder, flush=True); os._exit(1)"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert ended.stdout, ended.stderr
    return Path(ended.stdout.strip())


def test_is_of_the_user_alone_and_of_one_ray(temporary: Path) -> None:
    first, second = private_folder(), private_folder()
    assert first is not None
    assert second is not None
    assert first != second
    for folder in (first, second):
        assert folder.parent == temporary
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700


def test_is_removed_by_the_next_campaign_once_its_process_has_ended(temporary: Path) -> None:
    kept, left = private_folder(), abandoned(temporary)
    assert left.is_dir()
    private_folder()
    assert not left.exists()
    assert kept is not None
    assert kept.is_dir(), "its process lives"


@pytest.mark.parametrize("trap", ["link", "link within", "no mark", "more than Ray's"])
def test_what_is_not_ours_is_left_where_it_is(temporary: Path, trap: str) -> None:
    users = temporary / "users"
    (users / "ray").mkdir(parents=True)
    (users / MARK).touch()
    (users / "ray" / "thesis.txt").write_text("years")
    place = temporary / "tma_ray-12345678"
    if trap == "link":
        place.symlink_to(users)
    else:
        place.mkdir()
        (place / "notes.txt").write_text("the user's")
        if trap != "no mark":
            (place / MARK).touch()
        if trap == "link within":
            (place / "ray").symlink_to(users / "ray")
    folder = private_folder()
    assert folder is not None
    assert folder not in (place, users)
    assert (users / "ray" / "thesis.txt").read_text() == "years"
    assert place.is_symlink() or (place / "notes.txt").read_text() == "the user's"


def test_a_place_with_too_long_a_path_for_sockets_is_not_used(
    temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tma_ray.campaign.cluster.heads.LONGEST_PLACE", LONGEST_PLACE)
    long = temporary / ("long" * 10)
    long.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(long))
    folder = private_folder()
    assert folder is not None
    assert folder.parent == Path("/tmp")
    (folder / MARK).unlink()
    folder.rmdir()


def test_what_the_user_chooses_is_left_to_ray(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RAY_TMPDIR", "/somewhere")
    assert private_folder() is None
