"""Attempts that die with their driver: the next attempt at the run writes their row."""

from __future__ import annotations

from pathlib import Path

import pytest
from small_runs import rows, run, small_spec

from tma_ray.results import AttemptOutcome, Committer, Results, RunStatus, Store, Table
from tma_ray.runs import Placement, RunSpec
from tma_ray.runs.attempt import Attempt

EVERY_EPISODE = Placement(checkpoint_seconds=0.0)


def die(spec: RunSpec, root: Path, episodes: int) -> Attempt:
    """Leave what a process leaves that is killed after so many episodes."""
    committer = Committer.open(root)
    number, left = committer.start(spec.record()), iter(range(episodes))
    attempt = Attempt(spec, committer.store, number, EVERY_EPISODE)
    with pytest.raises(StopIteration):
        attempt.execute(lambda: next(left) < 0, lambda parts: committer.publish(spec.record(), number, parts))
    attempt.close()
    return attempt


def test_the_next_attempt_writes_the_row_of_one_that_died_with_its_driver(tmp_path: Path) -> None:
    spec, root = small_spec(tmp_path, steps=1_000), tmp_path / "root"
    lost = [die(spec, root, episodes=3), die(spec, root, episodes=2)]
    assert len(rows(root, Table.ATTEMPTS)) == 1, "that of the first is written by the second"
    run(spec, root)
    found = sorted(rows(root, Table.ATTEMPTS), key=lambda row: row["attempt"])
    assert [row["outcome"] for row in found] == ["lost", "lost", "done"]
    for row, attempt in zip(found, lost, strict=False):
        record = attempt.record(AttemptOutcome.LOST)
        assert row["started_at"] == record.started_at
        assert 0 < row["wall_seconds"] < record.wall_seconds
        assert (row["host"], row["fingerprint"]) == (record.host, record.fingerprint)


def test_of_an_attempt_that_never_began_its_start_is_known(tmp_path: Path) -> None:
    spec, root = small_spec(tmp_path, steps=1_000), tmp_path / "root"
    Committer.open(root).start(spec.record())
    run(spec, root)
    lost, done = sorted(rows(root, Table.ATTEMPTS), key=lambda row: row["attempt"])
    assert (lost["outcome"], lost["wall_seconds"], lost["host"]) == ("lost", 0.0, "")
    assert lost["started_at"] <= done["started_at"]


def test_an_attempt_that_was_withdrawn_has_no_row_and_keeps_its_number(tmp_path: Path) -> None:
    spec, root = small_spec(tmp_path, steps=1_000), tmp_path / "root"
    committer = Committer.open(root)
    committer.withdraw(spec.run_id, committer.start(spec.record()))
    run(spec, root)
    assert [(row["attempt"], row["outcome"]) for row in rows(root, Table.ATTEMPTS)] == [(1, "done")]


def test_an_attempt_that_has_its_row_keeps_it(tmp_path: Path) -> None:
    spec, root = small_spec(tmp_path, steps=1_000), tmp_path / "root"
    run(spec, root, stop_after=3)
    stopped = rows(root, Table.ATTEMPTS)
    run(spec, root)
    assert [row["outcome"] for row in rows(root, Table.ATTEMPTS)] == ["stopped", "done"]
    assert rows(root, Table.ATTEMPTS)[0] == stopped[0]


def test_a_driver_that_dies_before_the_last_row_leaves_it_to_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec, root = small_spec(tmp_path, steps=1_000), tmp_path / "root"
    with monkeypatch.context() as patch:
        patch.setattr(Committer, "record_attempt", killed)
        with pytest.raises(KeyboardInterrupt):
            run(spec, root)
    assert [manifest.status for manifest in Results.open(root).runs()] == [RunStatus.DONE]
    assert rows(root, Table.ATTEMPTS) == []
    Committer.open(root).sweep()
    assert [row["outcome"] for row in rows(root, Table.ATTEMPTS)] == ["done"]
    assert Store.open(root).files("staging") == ()


def killed(*_: object) -> None:
    raise KeyboardInterrupt
