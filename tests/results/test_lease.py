"""Leases and heartbeats: who holds a root, who asks it to stop, and who is alive."""

import errno
import fcntl
import json
import math
import multiprocessing
import os
import subprocess
import sys
import time
from collections import Counter
from dataclasses import replace
from multiprocessing.synchronize import Barrier
from pathlib import Path
from typing import Any

import pytest

from tma_ray.results import (
    Heartbeat,
    HeartbeatWriter,
    LearnerProgress,
    Lease,
    NotRunningError,
    RootInUseError,
    RunProgress,
    StorageError,
    Store,
    ask_to_stop,
    holder_of,
)
from tma_ray.results.layout import HEARTBEAT_FILE, LEASE_FILE, STOP_FILE
from tma_ray.results.lease import HEARTBEAT_SECONDS, SILENT_SECONDS, STOP_CHECK_SECONDS, Process


class Clock:
    now = 1_000_000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


def test_a_second_campaign_is_refused_while_the_first_renews_its_lease(store: Store, clock: Clock) -> None:
    first = Lease(store, "stumps on head-1", 100.0, clock)
    first.acquire()
    for _ in range(2):
        clock.now += 99
        with pytest.raises(RootInUseError, match="stumps on head-1, last sign of life 99 s ago"):
            Lease(store, "parkour", 100.0, clock).acquire()
        first.renew()


def test_the_lease_of_a_killed_campaign_runs_out_and_its_zombie_notices(store: Store, clock: Clock) -> None:
    zombie = Lease(store, "zombie", 100.0, clock)
    zombie.acquire()
    clock.now += 100
    successor = Lease(store, "successor", 100.0, clock)
    successor.acquire()
    with pytest.raises(RootInUseError, match=r"zombie has lost .* to successor"):
        zombie.renew()
    zombie.release()
    successor.renew()


def test_a_released_lease_is_free_at_once(store: Store, clock: Clock) -> None:
    with pytest.raises(KeyError), Lease(store, "first", 100.0, clock) as first:
        raise KeyError
    with Lease(store, "second", 100.0, clock), pytest.raises(RootInUseError):
        first.renew()
    with pytest.raises(RootInUseError, match="nobody"):
        first.renew()


def test_a_lease_that_a_full_disk_keeps_hides_no_error(store, clock, monkeypatch):
    def refuse(_: Lease) -> None:
        raise StorageError("no space")

    monkeypatch.setattr(Lease, "release", refuse)
    with pytest.raises(KeyError), Lease(store, "first", 100.0, clock):
        raise KeyError
    clock.now += 100
    with pytest.raises(StorageError), Lease(store, "second", 100.0, clock):
        pass


def test_of_two_that_start_at_once_one_is_refused_at_its_first_renewal(store: Store, clock: Clock) -> None:
    first, second = Lease(store, "first", 100.0, clock), Lease(store, "second", 100.0, clock)
    first.acquire()
    lease = store.read_bytes("lease.json")
    store.delete("lease.json")
    second.acquire()
    store.write_bytes("lease.json", lease)  # the later write wins
    first.renew()
    with pytest.raises(RootInUseError, match="second has lost"):
        second.renew()


def test_the_lease_of_a_dead_process_of_this_machine_is_free_at_once(store: Store, tmp_path: Path) -> None:
    script = (
        "import sys; from tma_ray.results import Lease, Store\n"
        f"Lease(Store.open({str(tmp_path / 'root')!r}), 'killed').acquire()"
    )
    subprocess.run([sys.executable, "-c", script], check=True)
    with Lease(Store.open(tmp_path / "root"), "successor") as successor:
        successor.keep()


def test_a_campaign_is_asked_to_stop_from_anywhere_and_only_once(store: Store) -> None:
    clock = Clock()
    with pytest.raises(NotRunningError, match="nothing to stop"):
        ask_to_stop(store)
    with Lease(store, "stumps on head-1", clock=clock) as lease:
        assert not lease.asked_to_stop()
        clock.now = time.time()
        lease.renew()
        assert ask_to_stop(store) == "stumps on head-1"
        clock.now += STOP_CHECK_SECONDS
        assert lease.asked_to_stop()
    with Lease(store, "the next", clock=clock) as lease:
        assert not lease.asked_to_stop(), "the request was for its predecessor"


def test_a_request_left_by_a_killed_campaign_does_not_stop_the_next(store: Store) -> None:
    killed = Lease(store, "killed")
    killed.acquire()
    ask_to_stop(store)
    store.delete(LEASE_FILE)
    with Lease(store, "the next") as lease:
        assert not lease.asked_to_stop()


def test_a_dead_campaign_cannot_be_asked(store: Store) -> None:
    Lease(store, "long gone", clock=lambda: time.time() - 1000).acquire()
    with pytest.raises(NotRunningError, match="long gone is dead"):
        ask_to_stop(store)


def test_who_holds_a_root_is_known_until_the_lease_ends(store: Store) -> None:
    assert holder_of(store) is None
    with Lease(store, "stumps"):
        assert holder_of(store) == "stumps"
        assert holder_of(store, seconds=0.0) is None
    assert holder_of(store) is None


DAMAGED = {
    "empty": b"",
    "an object": b"{}",
    "a list": b"[]",
    "truncated": b'{"holder": "a campai',
    "text for a time": b'{"holder": "a", "token": "b", "renewed_at": "noon", "process": null}',
    "a huge time": b'{"holder": "a", "token": "b", "renewed_at": 1e300, "process": null}',
    "another encoding": '{"holder": "a"}'.encode("utf-16"),
}


@pytest.mark.parametrize("content", DAMAGED.values(), ids=DAMAGED)
def test_a_damaged_lease_blocks_nobody(store: Store, clock: Clock, content: bytes) -> None:
    store.write_bytes(LEASE_FILE, content)
    with pytest.raises(NotRunningError, match=r"lease\.json is damaged.*nothing to stop"):
        ask_to_stop(store)
    assert holder_of(store) is None
    with Lease(store, "the next", 100.0, clock):
        assert holder_of(store, math.inf) == "the next"
    assert not store.exists(LEASE_FILE)


@pytest.mark.parametrize("content", DAMAGED.values(), ids=DAMAGED)
def test_a_holder_outlives_damage_of_its_files(store: Store, clock: Clock, content: bytes) -> None:
    with Lease(store, "the first", 100.0, clock) as lease:
        store.write_bytes(LEASE_FILE, content)
        store.write_bytes(STOP_FILE, content)
        clock.now += 30
        lease.keep()
        assert not lease.asked_to_stop()
        with pytest.raises(RootInUseError, match="the first"):
            Lease(store, "the second", 100.0, clock).acquire()
    assert not store.exists(LEASE_FILE)


def test_a_heartbeat_holds_the_root_while_the_lease_is_damaged(store: Store) -> None:
    with Lease(store, "stumps") as lease:
        HeartbeatWriter(store, "stumps").beat({})
        store.write_bytes(LEASE_FILE, b"{}")
        assert holder_of(store) == "stumps"
        with pytest.raises(RootInUseError, match="in use by stumps"):
            Lease(store, "the second").acquire()
        assert ask_to_stop(store) == "stumps"
        assert lease.asked_to_stop()


@pytest.mark.parametrize("alive", [False, True])
def test_a_lease_from_the_future_is_taken_if_not_renewed(store: Store, clock: Clock, alive: bool) -> None:
    ahead = Clock()
    ahead.now = clock.now + 1e6
    other = Lease(store, "of another time", 100.0, ahead)
    other.acquire()
    waits = []

    def sleep(seconds: float) -> None:
        waits.append(seconds)
        ahead.now += seconds
        if alive:
            other.keep()

    lease = Lease(store, "the next", 100.0, clock, sleep)
    if alive:
        with pytest.raises(RootInUseError, match="of another time"):
            lease.acquire()
        other.renew()
    else:
        lease.acquire()
        with pytest.raises(RootInUseError, match="lost"):
            other.renew()
    assert waits[0] == 50.0


def test_a_campaign_beats_now_and_then_and_says_when_it_leaves(store: Store) -> None:
    assert Heartbeat.load(store) is None
    clock = Clock()
    pulse = HeartbeatWriter(store, "stumps on head-1", clock)
    runs = {"run": RunProgress(1000, 250.0)}
    pulse.beat(runs)
    first = Heartbeat.load(store)
    assert first == Heartbeat("stumps on head-1", clock.now, runs, process=Process.this())
    clock.now += HEARTBEAT_SECONDS - 1
    pulse.beat({})
    assert Heartbeat.load(store) == first
    clock.now += 1
    learner = LearnerProgress("node-1", "cuda", 48, 40, 5_000.0, 0.7, 21.5, 79.2)
    pulse.beat({}, [learner])
    second = Heartbeat.load(store)
    assert second.learners == (learner,)
    assert second.alive(clock.now)
    assert not second.alive(clock.now + SILENT_SECONDS)
    pulse.end()
    last = Heartbeat.load(store)
    assert last.ended
    assert not last.alive(clock.now)


def test_a_campaign_whose_process_is_known_to_be_dead_is_not_alive(store: Store) -> None:
    pulse = HeartbeatWriter(store, "stumps on head-1", Clock())
    pulse.beat({})
    given, this = Heartbeat.load(store), Process.this()
    assert this is not None
    assert given.alive(Clock.now)
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    assert not replace(given, process=replace(this, pid=ended.pid)).alive(Clock.now)
    elsewhere = replace(this, pid=ended.pid, boot="that of another machine")
    assert replace(given, process=elsewhere).alive(Clock.now)


def test_a_zombie_does_not_speak_for_its_successor(store: Store) -> None:
    zombie, successor = (HeartbeatWriter(store, name, Clock()) for name in ("zombie", "successor"))
    zombie.beat({})
    successor.beat({})
    zombie.end()
    heartbeat = Heartbeat.load(store)
    assert (heartbeat.holder, heartbeat.ended) == ("successor", False)


@pytest.mark.parametrize(
    "content", [*DAMAGED.values(), b'{"holder": "a", "at": 1, "runs": {"r": 3}, "ended": false}'], ids=repr
)
def test_a_damaged_heartbeat_is_none(store: Store, content: bytes) -> None:
    store.write_bytes(HEARTBEAT_FILE, content)
    assert Heartbeat.load(store) is None


PROCESSES, ROUNDS = 3, 15
EXPIRED = {"holder": "dead", "token": "old", "renewed_at": 0.0, "process": None}
LEFT_BEHIND = {"nothing": None, "an expired lease": json.dumps(EXPIRED), "a damaged lease": "{"}


def ask(place: str, barrier: Barrier, answers: Any) -> None:
    """Ask for the lease of each root in `place` as soon as all processes are ready; keep what it gets."""
    for root in sorted(Path(place).iterdir()):
        lease = Lease(Store.open(root), f"process {multiprocessing.current_process().name}")
        barrier.wait(60)
        try:
            lease.acquire()
            lease.renew()
        except RootInUseError:
            answers.put((root.name, "refused"))
        else:
            answers.put((root.name, "got it"))


@pytest.mark.parametrize("left", [*LEFT_BEHIND, "no locks", "no links", "no locks, no links"])
def test_exactly_one_process_gets_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, left: str) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.ENOTSUP, "not supported")

    if "no locks" in left:  # which a new lease does not need
        monkeypatch.setattr(fcntl, "flock", refuse)
    if "no links" in left:
        monkeypatch.setattr(os, "link", refuse)
    content = LEFT_BEHIND.get(left)
    for number in range(ROUNDS):
        root = tmp_path / f"root-{number:02d}"
        root.mkdir()
        if content is not None:
            (root / LEASE_FILE).write_text(content)
    context = multiprocessing.get_context("fork")
    barrier, answers = context.Barrier(PROCESSES), context.Queue()
    arguments = (str(tmp_path), barrier, answers)
    processes = [context.Process(target=ask, args=arguments) for _ in range(PROCESSES)]
    for process in processes:
        process.start()
    found = Counter(answers.get(timeout=60) for _ in range(PROCESSES * ROUNDS))
    for process in processes:
        process.join(60)
        assert process.exitcode == 0
    assert {found[root.name, "got it"] for root in tmp_path.iterdir()} == {1}
