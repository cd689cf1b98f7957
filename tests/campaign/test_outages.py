"""Publishing into a storage that refuses for a while, and into a root that was lost meanwhile."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from small_runs import small_spec

from tma_ray.campaign.failures import OutageError, RetryingCommitter
from tma_ray.results import Committer, RootInUseError, StorageError, Store
from tma_ray.results.storage import FolderStore
from tma_ray.results.storage import base as storage_errors


@pytest.fixture(autouse=True)
def short_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(storage_errors, "FIRST_PAUSE", 0.01)


def refusing(monkeypatch: pytest.MonkeyPatch, times: float) -> list[str]:
    """Has the storage refuse that often; returns the list of what it refused."""
    write, refused = FolderStore.write_bytes, []

    def refuse(store: Store, path: str, data: bytes) -> None:
        if len(refused) < times:
            refused.append(path)
            raise StorageError("the disk is full")
        write(store, path, data)

    monkeypatch.setattr(FolderStore, "write_bytes", refuse)
    return refused


def test_what_was_refused_is_tried_again_and_the_lease_looked_after_each_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    committer, looks = Committer.open(tmp_path / "root"), []
    retrying = RetryingCommitter(committer, lambda: looks.append(True), seconds=60.0)
    run = small_spec(tmp_path).record()
    refused = refusing(monkeypatch, times=3)
    assert retrying.call(Committer.start, run) == 0
    assert len(refused) == 3
    assert len(looks) == 4
    published = committer.manifest(run.run_id)
    assert published is not None
    assert published.attempt == 0


def test_an_outage_that_lasts_ends_the_campaign_and_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    retrying = RetryingCommitter(Committer.open(tmp_path / "root"), lambda: None, seconds=0.05)
    refusing(monkeypatch, times=float("inf"))
    with pytest.raises(OutageError, match=r"ends after 0 s of retries: the disk is full"):
        retrying.call(Committer.start, small_spec(tmp_path).record())


def test_nothing_is_published_into_a_root_that_was_lost_during_the_outage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    committer, looks = Committer.open(tmp_path / "root"), []

    def lost_the_second_time() -> None:
        looks.append(True)
        if len(looks) > 1:
            raise RootInUseError("another campaign has taken it")

    run: Any = small_spec(tmp_path).record()
    retrying = RetryingCommitter(committer, lost_the_second_time, seconds=60.0)
    refusing(monkeypatch, times=1)
    with pytest.raises(RootInUseError):
        retrying.call(Committer.start, run)
    assert committer.manifest(run.run_id) is None
