import itertools

import numpy as np
import pytest
import torch

from tma_ray.students import Transition
from tma_ray.students.replay import ReplayBuffer


def buffer(capacity: int, seed: int = 0) -> ReplayBuffer:
    return ReplayBuffer(capacity, 3, 2, np.random.default_rng(seed), torch.device("cpu"))


def stream(rng: np.random.Generator, count: int, ending: float):
    """Transitions of consecutive episodes, some terminated, some truncated, some broken off unannounced."""
    observation = rng.normal(size=3).astype(np.float32)
    for _ in range(count):
        following = rng.normal(size=3).astype(np.float32)
        end = rng.random()
        action, reward = rng.uniform(-1, 1, 2).astype(np.float32), float(np.float32(rng.normal()))
        terminated, truncated = end < ending / 3, ending / 3 <= end < 2 * ending / 3
        yield Transition(observation, action, reward, following, terminated, truncated)
        observation = rng.normal(size=3).astype(np.float32) if end < ending else following


def fill(replay: ReplayBuffer, transitions, count: int | None = None) -> list[Transition]:
    """Add the next `count` transitions, or all that there are; return them."""
    added = list(itertools.islice(transitions, count))
    for transition in added:
        replay.add(transition, transition.action)
    return added


def as_rows(samples) -> set[tuple[float, ...]]:
    parts = (samples.observations, samples.actions, samples.next_observations, samples.dones, samples.rewards)
    return {tuple(row.tolist()) for row in torch.cat(parts, dim=1)}


def expected_rows(transitions) -> set[tuple[float, ...]]:
    return {
        (*t.observation.tolist(), *t.action.tolist(), *t.next_observation.tolist(), t.terminated, t.reward)
        for t in transitions
    }


@pytest.mark.parametrize("capacity", [1, 2, 7, 40])
@pytest.mark.parametrize("ending", [0.0, 0.1, 1.0])
def test_a_ring_holds_exactly_the_newest_transitions_as_a_list_would(capacity, ending):
    rng = np.random.default_rng(capacity)
    replay, stored = buffer(capacity), []
    for index, transition in enumerate(stream(rng, 5 * capacity + 3, ending)):
        replay.add(transition, transition.action)
        stored = [*stored, transition][-capacity:]
        assert len(replay) == len(stored)
        if index % 3 == 0 or index > 4 * capacity:
            # so many draws that all are seen: the chance to miss one is under 1e-10
            assert as_rows(replay.sample(30 * capacity)) == expected_rows(stored)


def test_sampling_is_uniform():
    replay = buffer(20)
    transitions = fill(replay, stream(np.random.default_rng(1), 50, 0.2))
    rewards = replay.sample(40_000).rewards.numpy()
    shares = [np.mean(rewards == np.float32(t.reward)) for t in transitions[-20:]]
    np.testing.assert_allclose(shares, 1 / 20, atol=0.006)  # over 5 standard errors


def test_the_environment_may_reuse_its_arrays():
    replay = buffer(5)
    observation, following = np.zeros(3, np.float32), np.ones(3, np.float32)
    replay.add(Transition(observation, np.zeros(2, np.float32), 0.0, following, False, True), np.zeros(2))
    observation += 7
    following += 7
    samples = replay.sample(1)
    assert samples.observations.tolist() == [[0, 0, 0]]
    assert samples.next_observations.tolist() == [[1, 1, 1]]


def assert_same_future(first: ReplayBuffer, second: ReplayBuffer, source) -> None:
    for transition in source:
        for replay in (first, second):
            fill(replay, [transition])
        for ours, theirs in zip(first.sample(10), second.sample(10), strict=True):
            assert ours is theirs is None or torch.equal(ours, theirs)


@pytest.mark.parametrize("count", [0, 1, 13, 40, 41, 42, 90, 123])
def test_a_loaded_buffer_goes_on_as_the_saved_one(tmp_path, count, monkeypatch):
    monkeypatch.setattr("tma_ray.students.replay.SEGMENT_ROWS", 8)
    first, second = buffer(41), buffer(41)
    source = stream(np.random.default_rng(2), count + 60, 0.2)
    fill(first, source, count)
    first.save(tmp_path)
    second.load(tmp_path)
    assert_same_future(first, second, source)


@pytest.mark.parametrize("between", [0, 1, 3, 7, 8, 20, 39, 40, 41, 42, 100])
def test_incremental_saves_equal_full_ones(tmp_path, between, monkeypatch):
    monkeypatch.setattr("tma_ray.students.replay.SEGMENT_ROWS", 8)
    source = stream(np.random.default_rng(3), 10_000, 0.3)
    replay, previous = buffer(41), None
    for number in range(8):
        fill(replay, source, between)
        folder = tmp_path / str(number)
        folder.mkdir()
        for name in replay.save(folder, incremental=previous is not None):
            (folder / name).write_bytes((previous / name).read_bytes())
        loaded = buffer(41)
        loaded.load(folder)
        if number % 3 == 2:
            replay = loaded  # a resumed run builds on what it resumed from
            loaded = buffer(41)
            loaded.load(folder)
        if len(replay):
            assert as_rows(replay.sample(1500)) == as_rows(loaded.sample(1500))
        previous = folder
    replay._generator, loaded._generator = np.random.default_rng(0), np.random.default_rng(0)
    assert_same_future(replay, loaded, itertools.islice(source, 60))


def test_only_changed_segments_are_written(tmp_path, monkeypatch):
    monkeypatch.setattr("tma_ray.students.replay.SEGMENT_ROWS", 10)
    source = stream(np.random.default_rng(4), 1000, 0.0)
    replay, left_out = buffer(79), []
    for name, count, incremental in (("a", 200, True), ("b", 5, True), ("c", 5, False)):
        (tmp_path / name).mkdir()
        fill(replay, source, count)
        left_out.append(replay.save(tmp_path / name, incremental))
        assert not {path.name for path in (tmp_path / name).iterdir()} & set(left_out[-1])
    assert left_out[0] == left_out[2] == ()
    assert len(left_out[1]) == 6  # of 8: the new rows start a segment, and the row before them counts, too


def test_a_buffer_that_was_cleared_since_is_saved_in_full(tmp_path):
    source = stream(np.random.default_rng(5), 1000, 0.1)
    replay = buffer(41)
    for name in "ab":
        (tmp_path / name).mkdir()
        fill(replay, source, 9)
        assert replay.save(tmp_path / name, incremental=True) == ()
        replay.clear()


def test_a_cleared_buffer_remembers_nothing():
    replay = buffer(10)
    fill(replay, stream(np.random.default_rng(3), 17, 0.3))
    replay.clear()
    assert len(replay) == 0
    new = fill(replay, stream(np.random.default_rng(4), 4, 0.3))
    assert as_rows(replay.sample(300)) == expected_rows(new)


def test_what_is_kept_of_endings_goes_with_their_transitions(tmp_path):
    replay, sizes, source = buffer(20), [], stream(np.random.default_rng(6), 1000, 1.0)
    for count in (100, 900):
        fill(replay, source, count)
        replay.save(tmp_path)
        sizes.append(sum(path.stat().st_size for path in tmp_path.iterdir()))
    assert sizes[0] == sizes[1]


def test_a_large_buffer_takes_memory_only_as_it_fills(tmp_path):
    import resource

    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    replay = ReplayBuffer(20_000_000, 24, 4, np.random.default_rng(0), torch.device("cpu"))
    observation = np.zeros(24, np.float32)
    replay.add(Transition(observation, observation[:4], 0.0, observation, False, False), observation[:4])
    replay.sample(100)
    replay.save(tmp_path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000  # kB, of 2.5 GB
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) < 10_000
