"""Checkpoints build on each other; attempts leave each other's alone, and lost ones get their row."""

from pathlib import Path

import pytest
from small_runs import data_files, new_run, rows, run, small_spec

from tma_ray.results import (
    CHECKPOINTS,
    AttemptOutcome,
    Committer,
    Results,
    RunStatus,
    StaleAttemptError,
    Store,
    Table,
    retry,
)
from tma_ray.results.storage import FolderStore, StorageError
from tma_ray.results.storage import base as storage_errors
from tma_ray.runs import Placement, RunSpec
from tma_ray.runs.attempt import Attempt
from tma_ray.runs.checkpoints import Checkpoints
from tma_ray.runs.run import Run

EVERY_EPISODE = Placement(checkpoint_seconds=0.0)


def play(one: Run, episodes: int) -> None:
    for _ in range(episodes):
        one.advance()


def files(store: Store) -> list[str]:
    """Paths of the checkpoints' files: step, attempt, and name."""
    return ["/".join(path.split("/")[2:]) for path in store.files(CHECKPOINTS)]


def future(one: Run) -> list[tuple[float, int]]:
    return [(ended.episodic_return, ended.length) for ended in (one.advance() for _ in range(10)) if ended]


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return tmp_path / "root"


@pytest.fixture
def store(root: Path) -> Store:
    return Store.open(root)


@pytest.fixture
def spec(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> RunSpec:
    monkeypatch.setattr("tma_ray.students.replay.SEGMENT_ROWS", 100)
    return small_spec(tmp_path, "sac", "alp_gmm")


def test_full_segments_of_a_replay_buffer_are_written_once(spec: RunSpec, store: Store) -> None:
    one, checkpoints = new_run(spec, store.base), Checkpoints(store, spec.run_id, 0)
    sizes = []
    for _ in range(4):
        play(one, 20)
        sizes.append(checkpoints.save(one, (), "here"))
    newest = max(path.split("/")[0] for path in files(store))
    own = [path for path in files(store) if path.startswith(newest) and "replay-" in path]
    assert len(own) < 7 < len([path for path in files(store) if "replay-0" in path])
    other = new_run(spec, store.base, attempt=1)
    successor = Checkpoints(store, spec.run_id, 1)
    restored = successor.restore(other)
    assert restored.step == one.progress.step
    successor.save(other, (), "here")
    play(other, 1)
    assert successor.save(other, (), "here") < sizes[-1], "what was loaded is not written again"
    third = new_run(spec, store.base, attempt=2)
    assert Checkpoints(store, spec.run_id, 2).restore(third) is not None
    assert future(third) == future(other)


def test_only_the_newest_and_the_one_before_are_kept_with_all_they_need(spec: RunSpec, store: Store) -> None:
    one, checkpoints = new_run(spec, store.base), Checkpoints(store, spec.run_id, 0)
    for _ in range(5):
        play(one, 20)
        checkpoints.save(one, (), "here")
    indices = sorted(path for path in files(store) if path.endswith("index.json"))
    assert len(indices) == 2
    store.delete(f"{CHECKPOINTS}/{spec.run_id}/{indices[-1]}")
    assert Checkpoints(store, spec.run_id, 1).restore(new_run(spec, store.base, 1)) is not None
    states = [path for path in files(store) if path.endswith("run.pickle")]
    assert len(states) == 2, "small files of older checkpoints are gone"


def test_after_a_checkpoint_that_could_not_be_written_the_next_one_is_complete(spec, store, monkeypatch):
    one, checkpoints = new_run(spec, store.base), Checkpoints(store, spec.run_id, 0)
    play(one, 30)
    checkpoints.save(one, (), "here")
    play(one, 30)
    with monkeypatch.context() as patch:
        patch.setattr(FolderStore, "write_bytes", full_disk)
        with pytest.raises(StorageError):
            checkpoints.save(one, (), "here")
    checkpoints.save(one, (), "here")
    other = new_run(spec, store.base, attempt=1)
    restored = Checkpoints(store, spec.run_id, 1).restore(other)
    assert restored.step == one.progress.step
    assert future(other) == future(one)


def test_an_attempt_taken_for_lost_takes_nothing_from_its_successor(spec: RunSpec, store: Store) -> None:
    lost, before = new_run(spec, store.base), Checkpoints(store, spec.run_id, 0)
    play(lost, 30)
    before.save(lost, (), "here")
    successor, after = new_run(spec, store.base, attempt=1), Checkpoints(store, spec.run_id, 1)
    after.restore(successor)
    play(successor, 5)
    after.save(successor, (), "here")
    for _ in range(3):
        play(lost, 20)
        before.save(lost, (), "here")
    kept = [path for path in files(store) if "-attempt-001/" in path]
    assert any(path.endswith("index.json") for path in kept)
    assert any(path.endswith("run.pickle") for path in kept)


def test_an_attempt_that_was_replaced_ends_at_its_next_checkpoint(spec: RunSpec, store: Store) -> None:
    committer = Committer(store)
    number = committer.start(spec.record())
    attempt = Attempt(spec, store, number, EVERY_EPISODE)
    published = []

    def replace(parts: object) -> None:
        published.append(parts)
        committer.start(spec.record())

    with pytest.raises(StaleAttemptError, match="attempt 0 is stale, 1 is accepted"):
        attempt.execute(lambda: False, replace)
    assert len(published) == 1


def full_disk(*arguments: object) -> None:
    raise StorageError("the disk is full")


@pytest.mark.slow
def test_a_run_outlasts_a_full_disk_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every tenth file that is written fails at first."""
    spec = small_spec(tmp_path, teacher="alp_gmm", steps=400, evaluation_interval=200)
    run(spec, tmp_path / "undisturbed", placement=EVERY_EPISODE)
    monkeypatch.setattr(storage_errors, "FIRST_PAUSE", 0.01)
    write, count = FolderStore.write_bytes, 0

    def now_and_then(store: Store, path: str, data: bytes) -> None:
        nonlocal count
        if not path.startswith(("logs", "tables")):  # of which one action writes many
            count += 1
            if count % 10 == 5:
                full_disk()
        write(store, path, data)

    with monkeypatch.context() as patch:
        patch.setattr(FolderStore, "write_bytes", now_and_then)
        assert run(spec, tmp_path / "full", placement=EVERY_EPISODE) == "done"
    assert count > 100
    assert data_files(tmp_path / "full") == data_files(tmp_path / "undisturbed")


def test_a_disk_that_stays_full_ends_the_attempt(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    spec = small_spec(tmp_path, teacher="alp_gmm", steps=1_000)
    run(spec, tmp_path / "undisturbed")
    monkeypatch.setattr(storage_errors, "FIRST_PAUSE", 0.01)
    write = FolderStore.write_bytes

    def no_checkpoint(store: Store, path: str, data: bytes) -> None:
        if path.startswith("checkpoints"):
            full_disk()
        write(store, path, data)

    with monkeypatch.context() as patch:
        patch.setattr(FolderStore, "write_bytes", no_checkpoint)
        with pytest.raises(StorageError, match="full"):
            run(spec, tmp_path / "full", placement=Placement(checkpoint_seconds=0.0, outage_seconds=0.05))
    assert run(spec, tmp_path / "full") == "done"
    assert data_files(tmp_path / "full") == data_files(tmp_path / "undisturbed")


def test_waiting_for_a_storage_ends_when_asked_to() -> None:
    asked = []
    with pytest.raises(StorageError):
        retry(full_disk, 1000.0, lambda: bool(asked.append(True)) or True)
    assert asked == [True]


def die(spec: RunSpec, root: Path, episodes: int) -> Attempt:
    """Leave what a process leaves that is killed after so many episodes."""
    committer = Committer.open(root)
    number, left = committer.start(spec.record()), iter(range(episodes))
    attempt = Attempt(spec, committer.store, number, EVERY_EPISODE)
    with pytest.raises(StopIteration):
        attempt.execute(lambda: next(left) < 0, lambda parts: committer.publish(spec.record(), number, parts))
    attempt.close()
    return attempt


@pytest.fixture
def short(tmp_path: Path) -> RunSpec:
    return small_spec(tmp_path, steps=300, evaluation_interval=300)


def test_the_next_attempt_writes_the_row_of_one_that_died_with_its_driver(short: RunSpec, root: Path) -> None:
    lost = [die(short, root, episodes=3), die(short, root, episodes=2)]
    assert len(rows(root, Table.ATTEMPTS)) == 1, "that of the first is written by the second"
    run(short, root)
    found = sorted(rows(root, Table.ATTEMPTS), key=lambda row: row["attempt"])
    assert [row["outcome"] for row in found] == ["lost", "lost", "done"]
    for row, attempt in zip(found, lost, strict=False):
        record = attempt.record(AttemptOutcome.LOST)
        assert row["started_at"] == record.started_at
        assert 0 < row["wall_seconds"] < record.wall_seconds
        assert (row["host"], row["fingerprint"]) == (record.host, record.fingerprint)


@pytest.mark.parametrize(("extensions", "warned"), [("AVX2", False), ("AVX512", True)])
def test_a_run_on_other_vector_extensions_says_so(short, root, monkeypatch, caplog, extensions, warned):
    """Virtual machines of different processors name the same model."""
    monkeypatch.setattr("torch.backends.cpu.get_cpu_capability", lambda: "AVX2")
    die(short, root, episodes=3)
    monkeypatch.setattr("torch.backends.cpu.get_cpu_capability", lambda: extensions)
    run(short, root)
    assert ("resumes on another machine" in caplog.text) == warned


def test_of_an_attempt_that_never_began_its_start_is_known(short: RunSpec, root: Path) -> None:
    Committer.open(root).start(short.record())
    run(short, root)
    lost, done = sorted(rows(root, Table.ATTEMPTS), key=lambda row: row["attempt"])
    assert (lost["outcome"], lost["wall_seconds"], lost["host"]) == ("lost", 0.0, "")
    assert lost["started_at"] <= done["started_at"]


def test_an_attempt_that_was_withdrawn_has_no_row_and_keeps_its_number(short: RunSpec, root: Path) -> None:
    committer = Committer.open(root)
    committer.withdraw(short.run_id, committer.start(short.record()))
    run(short, root)
    assert [(row["attempt"], row["outcome"]) for row in rows(root, Table.ATTEMPTS)] == [(1, "done")]


def test_an_attempt_that_has_its_row_keeps_it(short: RunSpec, root: Path) -> None:
    run(short, root, stop_after=3)
    stopped = rows(root, Table.ATTEMPTS)
    run(short, root)
    assert [row["outcome"] for row in rows(root, Table.ATTEMPTS)] == ["stopped", "done"]
    assert rows(root, Table.ATTEMPTS)[0] == stopped[0]


def test_a_driver_that_dies_before_the_last_row_leaves_it_to_the_next(short, root, monkeypatch):
    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Committer, "record_attempt", killed)
        with pytest.raises(KeyboardInterrupt):
            run(short, root)
    assert [manifest.status for manifest in Results.open(root).runs()] == [RunStatus.DONE]
    assert rows(root, Table.ATTEMPTS) == []
    Committer.open(root).sweep()
    assert [row["outcome"] for row in rows(root, Table.ATTEMPTS)] == ["done"]
    assert Store.open(root).files("staging") == ()
