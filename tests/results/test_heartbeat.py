import subprocess
import sys
from dataclasses import replace

from tma_ray.results import Heartbeat, HeartbeatWriter, LearnerProgress, RunProgress, Store
from tma_ray.results.layout import HEARTBEAT_FILE
from tma_ray.results.lease import HEARTBEAT_SECONDS, SILENT_SECONDS, Process


class Clock:
    now = 1_000_000.0

    def __call__(self) -> float:
        return self.now


def test_a_campaign_beats_now_and_then_and_says_when_it_leaves(store: Store) -> None:
    assert Heartbeat.load(store) is None
    clock = Clock()
    pulse = HeartbeatWriter(store, "stumps on head-1", clock)
    pulse.beat({"run": RunProgress(1000, 250.0)})
    first = Heartbeat.load(store)
    runs = {"run": RunProgress(1000, 250.0)}
    assert first == Heartbeat("stumps on head-1", clock.now, runs, process=Process.this())
    clock.now += HEARTBEAT_SECONDS - 1
    pulse.beat({})
    assert Heartbeat.load(store) == first
    clock.now += 1
    learner = LearnerProgress("node-1", "cuda", 48, 40, 5_000.0, 0.7, 21.5, 79.2)
    pulse.beat({}, [learner])
    second = Heartbeat.load(store)
    assert second is not None
    assert second.learners == (learner,)
    assert second.alive(clock.now)
    assert not second.alive(clock.now + SILENT_SECONDS)
    pulse.end()
    last = Heartbeat.load(store)
    assert last is not None
    assert last.ended
    assert not last.alive(clock.now)


def test_a_campaign_whose_process_is_known_to_be_dead_is_not_alive(store: Store) -> None:
    pulse = HeartbeatWriter(store, "stumps on head-1", Clock())
    pulse.beat({})
    given, this = Heartbeat.load(store), Process.this()
    assert given is not None
    assert this is not None
    assert given.alive(Clock.now)
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    assert not replace(given, process=replace(this, pid=ended.pid)).alive(Clock.now)
    elsewhere = replace(this, pid=ended.pid, boot="that of another machine")
    assert replace(given, process=elsewhere).alive(Clock.now)


def test_a_zombie_does_not_speak_for_its_successor(store: Store) -> None:
    zombie, successor = (
        HeartbeatWriter(store, "zombie", Clock()),
        HeartbeatWriter(store, "successor", Clock()),
    )
    zombie.beat({})
    successor.beat({})
    zombie.end()
    heartbeat = Heartbeat.load(store)
    assert heartbeat is not None
    assert (heartbeat.holder, heartbeat.ended) == ("successor", False)


def test_a_damaged_heartbeat_is_none(store: Store) -> None:
    for content in (
        b"",
        b"[]",
        b'{"holder": 1}',
        b'{"holder": "a", "at": 1, "runs": {"r": 3}, "ended": false}',
    ):
        store.write_bytes(HEARTBEAT_FILE, content)
        assert Heartbeat.load(store) is None
