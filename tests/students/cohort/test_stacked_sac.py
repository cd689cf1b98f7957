"""Stacked SAC: stable-baselines3's update in every slot, and no run in the way of another."""

import numpy as np
import pytest
import stable_baselines3
import torch
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from stock_models import ACTION, OBSERVATION, sac

from tma_ray.students.cohort.sac import SACNetworks, StackedSAC
from tma_ray.students.hyperparameters import LogStd, SACHyperparameters
from tma_ray.students.mlp.network import FlatParameters, blocks_of
from tma_ray.students.sac import Transitions

pytestmark = pytest.mark.usefixtures("_both_ways")

CPU = torch.device("cpu")
WIDTH = 3
HYPER = SACHyperparameters(hidden_units=(20, 12), batch_size=16)


def learner(hyper=HYPER, width=WIDTH, capacity=60, **options) -> StackedSAC:
    return StackedSAC((OBSERVATION, ACTION), hyper, width, capacity, CPU, **options)


def networks(seed: int) -> SACNetworks:
    rng = np.random.default_rng(seed)
    actor = 0.2 * rng.normal(size=OBSERVATION * 20 + 20 + 20 * 12 + 12 + 12 * 6 + 6).astype(np.float32)
    critics = 0.2 * rng.normal(size=(2, 8 * 20 + 20 + 20 * 12 + 12 + 12 + 1)).astype(np.float32)
    moments = [np.zeros_like(part) for part in (actor, actor, critics, critics)]
    return SACNetworks(actor, critics, critics.copy(), *moments, 0, 0)


def play(stacked: StackedSAC, slot: int, seed: int, updates: int, length: int = 30) -> None:
    """Store an episode, which depends on the seed only, and owes updates."""
    rng = np.random.default_rng(seed)
    observations = rng.normal(size=(length + 1, OBSERVATION)).astype(np.float32)
    actions = rng.uniform(-1, 1, (length, ACTION)).astype(np.float32)
    stacked.store(slot, observations, actions, rng.normal(size=length).astype(np.float32), seed % 2 == 0)
    stacked.owe(slot, updates)


def enter(stacked: StackedSAC, slot: int, run: int) -> None:
    stacked.join(slot, networks(run), key=2**40 * run + 7)
    play(stacked, slot, run, updates=0)


def assert_same_bits(ours: SACNetworks, theirs: SACNetworks) -> None:
    for own, other in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(np.asarray(own), np.asarray(other))
        assert np.asarray(own).tobytes() == np.asarray(other).tobytes()


def flat(model: stable_baselines3.SAC) -> list[np.ndarray]:
    """The actor (p,), critics and targets (2, q) as a run alone has them."""
    actor = FlatParameters([blocks_of(model.actor.latent_pi, model.actor.mu, model.actor.log_std)])
    pairs = (model.critic.q_networks, model.critic_target.q_networks)
    critics = [FlatParameters([*map(blocks_of, pair)]).values.view(2, -1) for pair in pairs]
    return [values.numpy(force=True).copy() for values in (actor.values, *critics)]


@pytest.fixture
def _seeded():
    with torch.random.fork_rng():
        torch.manual_seed(4)
        yield


@pytest.mark.usefixtures("_seeded")
@pytest.mark.parametrize("log_std", list(LogStd))
def test_every_slot_equals_stock_after_ten_updates(log_std, monkeypatch):
    # a coefficient that float32 has, too: theirs is rounded to it
    hyper = SACHyperparameters(
        hidden_units=(20, 12), batch_size=16, entropy_coefficient=0.25, log_std=log_std
    )
    stacked = learner(hyper, dtype=torch.float64)
    stocks = [sac(hyper, torch.float64) for _ in range(WIDTH)]
    initial = [flat(model) for model in stocks]
    for slot, (actor, critics, targets) in enumerate(initial):
        moments = [np.zeros_like(part) for part in (actor, actor, critics, critics)]
        stacked.join(slot, SACNetworks(actor, critics, targets, *moments, 0, 0), key=slot)
    shapes = ((OBSERVATION,), (ACTION,), (OBSERVATION,), (1,), (1,))
    for _ in range(10):
        batch = Transitions(*(torch.randn(WIDTH, 16, *shape).double() for shape in shapes))
        batch = batch._replace(actions=batch.actions.tanh(), dones=(batch.dones > 1).double())
        noise, next_noise = torch.randn(2, WIDTH, 16, ACTION).double()
        stacked._learn(batch, noise, next_noise, torch.ones(WIDTH, dtype=torch.bool))
        for slot, model in enumerate(stocks):
            samples = ReplayBufferSamples(*(column[slot] for column in batch))
            draws = iter((noise[slot], next_noise[slot]))

            def drawn(*_, draws=draws, **__):
                return next(draws)

            monkeypatch.setattr(model.replay_buffer, "sample", lambda *_, samples=samples, **__: samples)
            monkeypatch.setattr(torch.distributions.normal, "_standard_normal", drawn)
            model.train(1, 16)
    for slot, model in enumerate(stocks):
        ours, theirs = stacked.networks(slot), flat(model)
        for own, other, first in zip(ours[:3], theirs, initial[slot], strict=True):
            assert np.abs(own - other).max() < 1e-9
            assert np.abs(own - first).max() > 1e-5
        assert ours.step == 10
        logged = model.logger.name_to_value
        for name, value in stacked.figures(slot).items():
            np.testing.assert_allclose(value, logged[f"train/{name}"], rtol=1e-6)


def alone(run: int, slot: int = 1) -> SACNetworks:
    stacked = learner()
    enter(stacked, slot, run)
    stacked.owe(slot, 50)
    stacked.advance(50)
    return stacked.networks(slot)


def test_a_run_learns_the_same_bits_whoever_its_neighbours_are():
    expected = alone(run=1)
    assert (expected.actor != networks(1).actor).mean() > 0.9
    full = learner()
    for slot in range(WIDTH):
        enter(full, slot, run=slot)
        full.owe(slot, 50)
    full.advance(100)
    assert_same_bits(full.networks(1), expected)

    changing = learner()
    for slot in (0, 1):
        enter(changing, slot, run=slot)
        changing.owe(slot, 25)
    changing.advance(25)
    changing.leave(0)
    enter(changing, 2, run=5)
    changing.owe(1, 10)
    changing.advance(10)
    changing.owe(2, 80)
    changing.owe(1, 15)
    for _ in range(10):
        changing.advance(7)
    assert_same_bits(changing.networks(1), expected)
    assert changing.owed.tolist() == [0, 0, 10]


@pytest.mark.parametrize("slot", [0, 2])
def test_a_run_learns_the_same_bits_in_every_slot(slot):
    assert_same_bits(alone(run=1, slot=slot), alone(run=1, slot=1))


def test_an_idle_run_does_not_change_and_a_diverged_neighbour_harms_nobody():
    stacked = learner()
    for slot in range(WIDTH):
        enter(stacked, slot, run=slot)
    broken = networks(0)
    broken.actor[:] = np.nan
    broken.critics[:] = np.inf
    stacked.join(0, broken, key=0)
    play(stacked, 0, 0, updates=50)
    stacked.owe(1, 50)
    before = stacked.networks(2)
    stacked.advance(50)
    assert_same_bits(stacked.networks(2), before)
    assert_same_bits(stacked.networks(1), alone(run=1))
    play(stacked, 2, seed=9, updates=3)
    stacked.advance(3)
    idle = stacked.networks(0)
    assert np.isnan(idle.actor).any()
    stacked.leave(0)
    stacked.owe(1, 1)
    stacked.advance(1)
    assert not any(np.asarray(part).any() for part in stacked.networks(0)[:7])
    assert np.isfinite(stacked.networks(2).actor).all()


def test_a_run_goes_on_bit_for_bit_in_another_learner():
    stacked, other = learner(), learner()
    enter(stacked, 1, run=1)
    stacked.owe(1, 20)
    stacked.advance(20)
    other.join(2, stacked.networks(1), key=2**40 + 7)
    for piece in stacked._replay.pieces(1):
        other.store(2, *piece)
    for own, slot in ((stacked, 1), (other, 2)):
        play(own, slot, seed=8, updates=13)
        own.advance(13)
    assert_same_bits(other.networks(2), stacked.networks(1))
    assert stacked.networks(1).number == 33


def test_padding_stays_zero():
    stacked = learner()
    enter(stacked, 0, run=1)
    stacked.owe(0, 20)
    stacked.advance(20)
    for memory, places in stacked._stacks():
        rows = memory.detach().clone()
        assert rows[..., places].any()
        rows[..., places] = 0
        assert not rows.any()


def test_actors_are_those_of_the_slots_in_the_order_asked_for():
    stacked = learner()
    for slot in range(WIDTH):
        enter(stacked, slot, run=slot)
    rows = stacked.actors([2, 0]).numpy()
    np.testing.assert_array_equal(rows, [networks(2).actor, networks(0).actor])


def test_memory_that_grows_changes_nothing():
    roomy, tight = learner(capacity=60), learner(capacity=60)
    for stacked in (roomy, tight):
        enter(stacked, 0, run=1)
    play(roomy, 0, seed=3, updates=0, length=60)
    ((observations, actions, rewards, terminated),) = roomy._replay.pieces(0)
    for start in range(60):  # the same transitions as episodes of one step, which need twice the rows
        step = slice(start, start + 1)
        piece = observations[start : start + 2], actions[step], rewards[step]
        tight.store(0, *piece, terminated and start == 59)
    assert tight._replay.moves > 0
    for stacked in (roomy, tight):
        stacked.owe(0, 5)
        stacked.advance(5)
    assert_same_bits(tight.networks(0), roomy.networks(0))


def test_bfloat16_layers_are_close_to_float32_ones_and_differ():
    precise = alone(run=1)
    stacked = learner(SACHyperparameters(hidden_units=(20, 12), batch_size=16, matmul_precision="medium"))
    enter(stacked, 1, run=1)
    stacked.owe(1, 50)
    stacked.advance(50)
    rounded = stacked.networks(1)
    moved = np.abs(precise.critics - networks(1).critics).mean()
    difference = np.abs(rounded.critics - precise.critics).mean()
    assert 0 < difference < 0.2 * moved
    assert rounded.critics.dtype == np.float32


def test_values_average_the_soft_value_over_the_noise_handed_in():
    stacked = learner()
    enter(stacked, 1, run=1)
    states = np.random.default_rng(0).normal(size=(4, OBSERVATION)).astype(np.float32)
    noise = np.random.default_rng(1).normal(size=(2, 4, ACTION)).astype(np.float32)
    both = stacked.values(1, states, noise)
    each = [stacked.values(1, states, sample[None]) for sample in noise]
    assert both.dtype == np.float64
    assert both.shape == (4,)
    np.testing.assert_allclose(both, np.mean(each, axis=0), rtol=1e-6)


@pytest.mark.slow
def test_compiled_updates_are_the_same_up_to_rounding():
    plain, stacked = learner(), learner(compiled="default")
    for own in (plain, stacked):
        for slot in range(WIDTH):
            enter(own, slot, run=slot)
            own.owe(slot, 10 * slot)
        own.advance(20)
    for slot in range(WIDTH):
        for ours, theirs in zip(stacked.networks(slot)[:3], plain.networks(slot)[:3], strict=True):
            np.testing.assert_allclose(ours, theirs, atol=1e-4)
    assert_same_bits(stacked.networks(0), plain.networks(0))
