"""Runs whose process is lost, silent or out of sight; storages that refuse for a while."""

import threading
from pathlib import Path
from typing import Any

import pytest
import ray
from ray.exceptions import ActorUnavailableError, RayError, RayTaskError
from small_runs import data_files, rows, small_spec
from test_campaign import alone, campaign, execute, idle, settings

from tma_ray.campaign.executors.actors import SeedActor, reason_for_loss
from tma_ray.campaign.failures import (
    LOG_SECONDS,
    LONGEST_LOSS_PAUSE,
    OutageError,
    Retries,
    RetryingCommitter,
    SilentRuns,
)
from tma_ray.campaign.settings import TeacherPlacement
from tma_ray.results import Committer, RootInUseError, StorageError, Store, Table
from tma_ray.results.storage import FolderStore
from tma_ray.results.storage import base as storage_errors
from tma_ray.runs.attempt import Report


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def test_the_reason_for_a_loss_is_a_sentence() -> None:
    full = StorageError("cannot write tables/episodes: no space left; free some space there")
    colours = "\x1b[36mray::SeedActor.run()\x1b[39m (pid=1)\n  File 'x.py', line 8\n" * 20
    raised = RayTaskError("run", colours, full, pid=1, ip="127.0.0.1").as_instanceof_cause()
    assert reason_for_loss(raised) == str(full)
    died = RayError("The actor died.\n\tclass_name: SeedActor\n\tpid: 15377\nIts worker was killed.")
    assert reason_for_loss(died) == "The actor died. Its worker was killed."


def test_each_loss_doubles_the_pause_and_too_many_give_a_run_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(storage_errors, "FIRST_PAUSE", 1.0)
    clock = Clock()
    retries = Retries(most_losses=12, clock=clock)
    (spec,) = campaign(idle("random")).plan().runs
    pauses = []
    for loss in range(12):
        assert retries.add_loss(spec, f"node-{loss % 2}")
        assert retries.specs == [spec]
        start = clock.now
        while not retries.due():
            clock.now += 1.0
        pauses.append(clock.now - start)
        assert len(retries) == 0
    assert pauses[:4] == [1, 2, 4, 8]
    assert max(pauses) == LONGEST_LOSS_PAUSE
    assert not retries.add_loss(spec, "node-0")
    assert retries.losses(spec.run_id) == 13
    assert retries.nodes_to_avoid(spec.run_id) == ("node-0", "node-1")
    assert retries.nodes_to_avoid("another") == ()


def test_a_second_call_of_a_run_waits_for_the_first_and_gives_the_same(tmp_path: Path) -> None:
    (spec,) = campaign(idle("random")).plan().runs
    store = Committer.open(tmp_path).store
    actor = SeedActor(spec.to_dict(), store, 0, settings().placement, TeacherPlacement.INLINE)
    results: list[Any] = []
    threads = [threading.Thread(target=lambda: results.append(actor.run())) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(results) == 3
    assert results[0]
    assert results[0] is results[1] is results[2]


class Network:
    """Ray as the executor sees it through a network that loses the first answers of seed actors."""

    def __init__(self, lost: int) -> None:
        self.lost = lost

    def __getattr__(self, name: str) -> Any:
        return getattr(ray, name)

    def get(self, *arguments: Any, **options: Any) -> Any:
        answer = ray.get(*arguments, **options)
        if self.lost > 0 and isinstance(answer, tuple | Report):
            self.lost -= 1
            raise ActorUnavailableError("the network is gone", None)
        return answer


@pytest.mark.usefixtures("cluster")
@pytest.mark.slow
def test_an_actor_out_of_sight_is_asked_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    network = Network(lost=3)
    monkeypatch.setattr("tma_ray.campaign.executors.ray_executor.ray", network)
    what = campaign(idle("random"))
    assert execute(what, tmp_path / "root", teachers=TeacherPlacement.INLINE).done == 1
    assert network.lost == 0
    attempts = rows(tmp_path / "root", Table.ATTEMPTS)
    assert [(row["attempt"], row["outcome"]) for row in attempts] == [(0, "done")]
    assert data_files(tmp_path / "root") == alone(what, tmp_path / "undisturbed")


@pytest.mark.usefixtures("cluster")
@pytest.mark.slow
def test_who_is_silent_for_too_long_is_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tma_ray.campaign.executors.ray_executor.ray", Network(lost=10_000))
    changes = {"unreachable_seconds": 0.6, "most_losses": 1, "teachers": TeacherPlacement.INLINE}
    ended = execute(campaign(idle("random")), tmp_path, **changes)
    assert (ended.done, ended.failed) == (0, 1)
    attempts = rows(tmp_path, Table.ATTEMPTS)
    assert [(row["attempt"], row["outcome"]) for row in attempts] == [(0, "lost"), (1, "lost")]


def test_silent_runs_are_logged_once_a_minute_and_lost_in_the_end(caplog: pytest.LogCaptureFixture) -> None:
    clock = Clock()
    silence = SilentRuns(most_seconds=300.0, clock=clock)
    for _ in range(600):
        assert not silence.has_expired("first")
        assert not silence.has_expired("second")
        clock.now += 0.5
    assert len(caplog.records) == 300 / LOG_SECONDS
    assert "first, second do not answer" in caplog.messages[-1]
    silence.end("second")
    clock.now += 0.5
    assert silence.has_expired("first")
    assert not silence.has_expired("second"), "its time began anew"


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


def test_what_was_refused_is_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    committer, looks = Committer.open(tmp_path / "root"), []
    retrying = RetryingCommitter(committer, lambda: looks.append(True), seconds=60.0)
    run = small_spec(tmp_path).record()
    refused = refusing(monkeypatch, times=3)
    assert retrying.call(Committer.start, run) == 0
    assert len(refused) == 3
    assert len(looks) == 4
    published = committer.manifest(run.run_id)
    assert published.attempt == 0


def test_a_lasting_outage_ends_the_campaign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    retrying = RetryingCommitter(Committer.open(tmp_path / "root"), lambda: None, seconds=0.05)
    refusing(monkeypatch, times=float("inf"))
    with pytest.raises(OutageError, match=r"ends after 0 s of retries: the disk is full"):
        retrying.call(Committer.start, small_spec(tmp_path).record())


def test_nothing_is_published_into_a_lost_root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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
