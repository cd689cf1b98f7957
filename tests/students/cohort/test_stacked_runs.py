"""Runs of a stacked learner, PPO's and SAC's alike: none is in the way of another, and each can move."""

import numpy as np
import pytest
from stacked_runs import PPO, SAC, WIDTH, assert_same_bits, enter

pytestmark = pytest.mark.usefixtures("_both_ways")


@pytest.fixture(params=[PPO, SAC], ids=["ppo", "sac"])
def kind(request):
    return request.param


def alone(kind, **changes):
    """Return run 1 after nine lessons, which are 54 updates."""
    stacked = kind.learner(changes)
    enter(kind, stacked, 1, run=1)
    for seed in range(9):
        kind.learn(stacked, 1, seed)
        stacked.advance(100)
    return stacked.networks(1)


def test_a_run_learns_the_same_bits_whoever_its_neighbours_are(kind):
    stacked = kind.learner()
    for slot in (0, 1):
        enter(kind, stacked, slot, run=slot)
    for seed in range(9):
        kind.learn(stacked, 1, seed)
        if seed < 6:
            kind.learn(stacked, 0, seed + 20)
        if seed == 6:  # half-way: one has gone, another comes
            stacked.leave(0)
            enter(kind, stacked, 2, run=7)
        if seed >= 6:
            stacked.advance(2)
            kind.learn(stacked, 2, seed)
        while stacked.owed[1]:
            stacked.advance(3)
        stacked.advance(100)
    assert_same_bits(stacked.networks(1), alone(kind))
    kind.learn(stacked, 2, 99)
    stacked.advance(2)
    assert stacked.owed.tolist() == [0, 0, 4]


def test_an_idle_run_does_not_change_and_a_diverged_neighbour_harms_nobody(kind):
    stacked, broken = kind.learner(), kind.networks(0)
    for part in broken[:2]:
        part[:] = np.nan
    kind.join(stacked, 0, broken, run=0)
    for slot in (1, 2):
        enter(kind, stacked, slot, run=slot)
    before = stacked.networks(2)
    for seed in range(9):
        for slot in (0, 1):
            kind.learn(stacked, slot, seed)
        stacked.advance(100)
    assert_same_bits(stacked.networks(2), before)
    assert_same_bits(stacked.networks(1), alone(kind))
    kind.learn(stacked, 2, 1)
    stacked.advance(1)
    assert np.isnan(stacked.networks(0)[0]).any()
    assert np.isfinite(stacked.networks(2)[0]).all()
    stacked.leave(0)
    stacked.advance(1)
    assert not any(part.any() for part in stacked.networks(0) if np.ndim(part))


def test_padding_stays_zero_and_a_run_goes_on_elsewhere(kind):
    stacked, other = kind.learner(), kind.learner()
    enter(kind, stacked, 0, run=1)
    kind.learn(stacked, 0, 5)
    stacked.advance(100)
    for memory, places in stacked._parameter_groups():
        rows = memory.detach().clone()
        assert rows[..., places].any()
        rows[..., places] = 0
        assert not rows.any()
    kind.move(stacked, 0, other, 2)
    enter(kind, other, 0, run=4)
    for own, slot in ((stacked, 0), (other, 2)):
        kind.learn(own, slot, 6)
        own.advance(100)
    assert_same_bits(other.networks(2), stacked.networks(0))
    actors = [other.networks(slot)[0] for slot in (2, 0)]
    np.testing.assert_array_equal(other.actors([2, 0]).numpy(), actors)


def test_bfloat16_layers_are_close_to_float32_ones_and_differ(kind):
    precise, rounded = alone(kind), alone(kind, matmul_precision="medium")
    difference = np.abs(precise[0] - rounded[0]).mean()
    assert 0 < difference < 0.2 * np.abs(precise[0] - kind.networks(1)[0]).mean()
    assert rounded[0].dtype == np.float32


@pytest.mark.slow
def test_compiled_updates_are_the_same_up_to_rounding(kind):
    plain, stacked = kind.learner(), kind.learner(compiled="default")
    for own in (plain, stacked):
        for slot in range(WIDTH):
            enter(kind, own, slot, run=slot)
        for slot in (1, 2):
            kind.learn(own, slot, slot)
        own.advance(100)
    for slot in range(WIDTH):
        for ours, theirs in zip(stacked.networks(slot)[:3], plain.networks(slot)[:3], strict=True):
            np.testing.assert_allclose(ours, theirs, atol=1e-4)
    assert_same_bits(stacked.networks(0), plain.networks(0))
