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
        yield Transition(
            observation,
            rng.uniform(-1, 1, 2).astype(np.float32),
            float(np.float32(rng.normal())),
            following,
            terminated=end < ending / 3,
            truncated=ending / 3 <= end < 2 * ending / 3,
        )
        observation = rng.normal(size=3).astype(np.float32) if end < ending else following


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
    transitions = list(stream(np.random.default_rng(1), 50, 0.2))
    for transition in transitions:
        replay.add(transition, transition.action)
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


@pytest.mark.parametrize("count", [0, 1, 13, 40, 41, 42, 90, 123])
def test_a_loaded_buffer_goes_on_as_the_saved_one(tmp_path, count):
    first, second = buffer(41), buffer(41)
    source = stream(np.random.default_rng(2), count + 60, 0.2)
    for _, transition in zip(range(count), source, strict=False):
        first.add(transition, transition.action)
    first.save(tmp_path / "replay.npz")
    second.load(tmp_path / "replay.npz")
    for transition in source:
        for replay in (first, second):
            replay.add(transition, transition.action)
        for ours, theirs in zip(first.sample(10), second.sample(10), strict=True):
            assert ours is theirs is None or torch.equal(ours, theirs)


def test_a_cleared_buffer_remembers_nothing():
    replay = buffer(10)
    old, new = (list(stream(np.random.default_rng(seed), 17, 0.3)) for seed in (3, 4))
    for transition in old:
        replay.add(transition, transition.action)
    replay.clear()
    assert len(replay) == 0
    for transition in new[:4]:
        replay.add(transition, transition.action)
    assert as_rows(replay.sample(300)) == expected_rows(new[:4])


def test_a_large_buffer_takes_memory_only_as_it_fills(tmp_path):
    import resource

    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    replay = ReplayBuffer(20_000_000, 24, 4, np.random.default_rng(0), torch.device("cpu"))
    observation = np.zeros(24, np.float32)
    replay.add(Transition(observation, observation[:4], 0.0, observation, False, False), observation[:4])
    replay.sample(100)
    replay.save(tmp_path / "replay.npz")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000  # kB, of 2.5 GB
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) < 10_000
