"""The stacked replay memory against a plain list of transitions."""

import numpy as np
import pytest
import torch

from tma_ray.students.cohort.replay import StackedReplay

CPU = torch.device("cpu")
WIDTH, CAPACITY = 3, 40


def episode(rng, length, start=None):
    observations = rng.normal(size=(length + 1, 2)).astype(np.float32)
    if start is not None:
        observations[0] = start
    return (
        observations,
        rng.uniform(-1, 1, (length, 1)).astype(np.float32),
        rng.normal(size=length).astype("f4"),
    )


def listed(observations, actions, rewards, terminated):
    last = len(rewards) - 1
    return [
        (*observations[i], *actions[i], *observations[i + 1], float(terminated and i == last), rewards[i])
        for i in range(len(rewards))
    ]


def newest_first(replay, model):
    """All transitions of all slots as the replay gives them by age."""
    ages = torch.arange(CAPACITY).expand(WIDTH, CAPACITY)
    ages = torch.minimum(ages, replay.kept[:, None] - 1)
    batch = replay.gather(replay.newest(ages), torch.float32)
    rows = torch.cat(batch, dim=-1).numpy()
    return [rows[slot, : len(model[slot])] for slot in range(WIDTH)]


def assert_same(replay, model):
    kept = [transitions[::-1][:CAPACITY] for transitions in model]
    assert replay.kept.tolist() == [max(1, len(own)) for own in kept]
    for own, expected in zip(newest_first(replay, kept), kept, strict=True):
        np.testing.assert_array_equal(own, np.array(expected, np.float32).reshape(own.shape))


@pytest.mark.parametrize(
    "longest", [1, 3, 30, 100], ids=["single steps", "short", "long", "over the capacity"]
)
def test_it_keeps_the_newest_transitions_of_each_run(longest):
    """Around the ring several times; episodes of a step need two rows each, for which the memory grows."""
    rng, replay = np.random.default_rng(longest), StackedReplay(WIDTH, CAPACITY, (2, 1), CPU)
    model, lasts = [[] for _ in range(WIDTH)], [None] * WIDTH
    for _ in range(max(30, 600 // longest)):
        slot, terminated = int(rng.integers(WIDTH - 1)), bool(rng.random() < 0.3)
        goes_on = rng.random() < 0.3
        parts = episode(rng, int(rng.integers(1, longest + 1)), lasts[slot])
        replay.store(slot, *parts, terminated and not goes_on)
        model[slot] += listed(*parts, terminated and not goes_on)
        lasts[slot] = parts[0][-1] if goes_on else None
        assert_same(replay, model)
    assert max(map(len, model)) > 2 * CAPACITY
    assert not model[WIDTH - 1]
    assert (replay.moves > 0) == (longest < 30)
    replay.clear(0)
    model[0] = []
    assert_same(replay, model)


def test_contents_fill_another_slot_with_the_same_transitions():
    rng, replay = np.random.default_rng(0), StackedReplay(WIDTH, CAPACITY, (2, 1), CPU)
    model = []
    for number in range(12):
        parts = episode(rng, 7)
        replay.store(0, *parts, number % 2 == 0)
        model += listed(*parts, number % 2 == 0)
    other = StackedReplay(WIDTH, CAPACITY, (2, 1), CPU)
    other.store(2, *episode(rng, 9), True)
    contents = replay.contents(0)
    assert len(contents.rows) == CAPACITY
    assert len(contents.observations) == CAPACITY + 6  # five episodes and most of a sixth
    other.fill(2, contents)
    assert_same(other, [[], [], model])
    for before, after in zip(contents, other.contents(2), strict=True):
        np.testing.assert_array_equal(before, after)
    parts = episode(rng, 11)
    other.store(2, *parts, False)
    assert_same(other, [[], [], model + listed(*parts, False)])


def test_an_empty_slot_has_empty_contents():
    replay = StackedReplay(WIDTH, CAPACITY, (2, 1), CPU)
    contents = replay.contents(1)
    assert [len(column) for column in contents] == [0] * 5
    replay.fill(1, contents)
    assert_same(replay, [[], [], []])
