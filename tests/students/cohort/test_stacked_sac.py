"""Stacked SAC and PPO: stable-baselines3's update in every slot; memory and values of SAC."""

import numpy as np
import pytest
import stable_baselines3
import torch
from stable_baselines3.common.type_aliases import ReplayBufferSamples, RolloutBufferSamples
from stacked_runs import HIDDEN, PPO, SAC, WIDTH, assert_same_bits, enter, untrained
from stock_models import ACTION, OBSERVATION, Batches, ppo, ppo_parameters, sac

from tma_ray.students.hyperparameters import LogStd, PPOHyperparameters, SACHyperparameters
from tma_ray.students.mlp.layout import Activation
from tma_ray.students.mlp.network import FlatParameters, blocks_of
from tma_ray.students.sac import Transitions

pytestmark = pytest.mark.usefixtures("_both_ways")


def flat(model: stable_baselines3.SAC) -> list[np.ndarray]:
    """The actor (p,), critics and targets (2, q) as a run alone has them."""
    actor = FlatParameters([blocks_of(model.actor.latent_pi, model.actor.mu, model.actor.log_std)])
    pairs = (model.critic.q_networks, model.critic_target.q_networks)
    critics = [FlatParameters([*map(blocks_of, pair)]).values.view(2, -1) for pair in pairs]
    return [values.numpy(force=True).copy() for values in (actor.values, *critics)]


@pytest.mark.usefixtures("_seeded")
@pytest.mark.parametrize("log_std", list(LogStd))
def test_every_slot_of_sac_equals_stock_after_ten_updates(log_std, monkeypatch):
    # a coefficient that float32 has, too: theirs is rounded to it
    changes = {"entropy_coefficient": 0.25, "log_std": log_std}
    hyper = SACHyperparameters(hidden_units=HIDDEN, batch_size=16, **changes)
    stacked = SAC.learner(changes, dtype=torch.float64)
    stocks = [sac(hyper, torch.float64) for _ in range(WIDTH)]
    initial = [flat(model) for model in stocks]
    for slot, parts in enumerate(initial):
        stacked.join(slot, untrained(*parts), key=slot)
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
        for name, value in stacked.metrics(slot).items():
            np.testing.assert_allclose(value, logged[f"train/{name}"], rtol=1e-6)


def test_memory_that_grows_changes_nothing():
    roomy, tight = SAC.learner(), SAC.learner()
    for stacked in (roomy, tight):
        enter(SAC, stacked, 0, run=1)
    SAC.learn(roomy, 0, seed=3, updates=0, length=60)
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


def test_values_average_the_soft_value_over_the_noise_handed_in():
    stacked = SAC.learner()
    enter(SAC, stacked, 1, run=1)
    states = np.random.default_rng(0).normal(size=(4, OBSERVATION)).astype(np.float32)
    noise = np.random.default_rng(1).normal(size=(2, 4, ACTION)).astype(np.float32)
    both = stacked.values(1, states, noise)
    each = [stacked.values(1, states, sample[None]) for sample in noise]
    assert both.dtype == np.float64
    assert both.shape == (4,)
    np.testing.assert_allclose(both, np.mean(each, axis=0), rtol=1e-6)


def epochs_of(rollout: tuple[np.ndarray, ...], orders: np.ndarray) -> list[list[RolloutBufferSamples]]:
    """Return the mini-batches of a rollout in a given order, by epoch."""
    columns = [torch.from_numpy(column).double() for column in rollout]
    parts = orders.reshape(len(orders), -1, PPO.values["batch_size"])
    return [[RolloutBufferSamples(*(column[rows] for column in columns)) for rows in each] for each in parts]


@pytest.mark.parametrize(
    "values",
    [
        {"value_clip_range": 0.2, "max_gradient_norm": 0.05},
        {"value_clip_range": None, "max_gradient_norm": 50.0},
        {"activation": Activation.TANH, "separate_trunks": True, "hidden_units": (10, 6)},
    ],
    ids=["clipped", "free", "separate trunks"],
)
def test_every_slot_of_ppo_equals_stock_after_ten_updates(values):
    changes = {**values, "epochs": 5, "entropy_coefficient": 0.01}
    hyper, stacked = PPOHyperparameters(**PPO.values | changes), PPO.learner(changes, dtype=torch.float64)
    for slot in range(WIDTH):
        enter(PPO, stacked, slot, run=slot)
        PPO.learn(stacked, slot, slot, epochs=5)
    assert stacked.owed.tolist() == [10] * WIDTH
    stacked.advance(10)
    for slot in range(WIDTH):
        model = ppo(hyper, torch.float64)
        ppo_parameters(model).values.copy_(torch.from_numpy(PPO.networks(slot).parameters))
        model.rollout_buffer = Batches(epochs_of(*PPO.experience(slot, epochs=5)))
        model.train()
        ours, theirs = stacked.networks(slot), ppo_parameters(model).values.numpy()
        assert np.abs(ours.parameters - theirs).max() < 1e-9
        assert np.abs(ours.parameters - PPO.networks(slot).parameters).max() > 1e-3
        assert ours.step == 10
        logged = model.logger.name_to_value
        figures = stacked.metrics(slot)
        assert figures.pop("approx_kl") > 0  # theirs is of the last epoch only
        for name, value in figures.items():
            np.testing.assert_allclose(value, logged[f"train/{name}"], rtol=1e-5, atol=1e-7)
