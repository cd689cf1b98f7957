"""Stacked PPO: stable-baselines3's update in every slot, and no run in the way of another."""

import numpy as np
import pytest
import torch
from stable_baselines3.common.type_aliases import RolloutBufferSamples
from stock_models import ACTION, OBSERVATION, ppo, ppo_parameters

from tma_ray.students.cohort.ppo import PPONetworks, StackedPPO
from tma_ray.students.hyperparameters import PPOHyperparameters
from tma_ray.students.mlp.layout import Activation

pytestmark = pytest.mark.usefixtures("_both_ways")

CPU = torch.device("cpu")
WIDTH, STEPS, BATCH = 3, 40, 20
SIZES = {"hidden_units": (20, 12), "steps_per_update": STEPS, "batch_size": BATCH}
HYPER = PPOHyperparameters(**SIZES, epochs=3)
PARAMETERS = OBSERVATION * 20 + 20 + 20 * 12 + 12 + 12 * 4 + 4 + ACTION


def networks(seed: int) -> PPONetworks:
    parameters = 0.2 * np.random.default_rng(seed).normal(size=PARAMETERS).astype(np.float32)
    return PPONetworks(parameters, np.zeros_like(parameters), np.zeros_like(parameters), 0)


def experience(seed: int, epochs: int = HYPER.epochs) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
    """A rollout with probabilities on both sides of the clip of a policy like those of `networks`."""
    rng = np.random.default_rng(seed)
    observations = rng.normal(size=(STEPS, OBSERVATION)).astype(np.float32)
    actions = rng.normal(size=(STEPS, ACTION)).astype(np.float32)
    likely = -0.5 * np.square(actions).sum(axis=1) - 0.5 * ACTION * np.log(2 * np.pi)
    values, advantages, returns = 0.3 * rng.normal(size=(3, STEPS)).astype(np.float32)
    shaken = (likely + 0.3 * rng.normal(size=STEPS)).astype(np.float32)
    orders = np.stack([rng.permutation(STEPS) for _ in range(epochs)])
    return (observations, actions, values, shaken, advantages, returns), orders


def learn(stacked: StackedPPO, slot: int, seed: int) -> None:
    stacked.store(slot, *experience(seed))


def assert_same_bits(ours: PPONetworks, theirs: PPONetworks) -> None:
    for own, other in zip(ours, theirs, strict=True):
        assert np.asarray(own).tobytes() == np.asarray(other).tobytes()


def alone(slot: int = 1, hyper: PPOHyperparameters = HYPER) -> PPONetworks:
    """A run after nine rollouts, which are 54 updates."""
    stacked = StackedPPO((OBSERVATION, ACTION), hyper, WIDTH, CPU)
    stacked.join(slot, networks(1))
    for seed in range(9):
        learn(stacked, slot, seed)
        stacked.advance(100)
    return stacked.networks(slot)


class Batches:
    """Stands in for a rollout buffer: the mini-batches of a rollout in a given order."""

    def __init__(self, rollout: tuple[np.ndarray, ...], orders: np.ndarray) -> None:
        self.values = self.returns = np.ones(4)
        columns = [torch.from_numpy(column).double() for column in rollout]
        parts = orders.reshape(len(orders), -1, BATCH)
        self.epochs = iter([[RolloutBufferSamples(*(c[rows] for c in columns)) for rows in e] for e in parts])

    def get(self, batch_size):
        return next(self.epochs)


@pytest.mark.parametrize(
    "values",
    [
        {"value_clip_range": 0.2, "max_gradient_norm": 0.05},
        {"value_clip_range": None, "max_gradient_norm": 50.0},
        {"activation": Activation.TANH, "separate_trunks": True, "hidden_units": (10, 6)},
    ],
    ids=["clipped", "free", "separate trunks"],
)
def test_every_slot_equals_stock_after_ten_updates(values):
    hyper = PPOHyperparameters(**{**SIZES, **values}, epochs=5, entropy_coefficient=0.01)
    stacked = StackedPPO((OBSERVATION, ACTION), hyper, WIDTH, CPU, torch.float64)
    for slot in range(WIDTH):
        stacked.join(slot, networks(slot))
        stacked.store(slot, *experience(slot, epochs=5))
    assert stacked.owed.tolist() == [10] * WIDTH
    stacked.advance(10)
    for slot in range(WIDTH):
        model = ppo(hyper, torch.float64)
        ppo_parameters(model).values.copy_(torch.from_numpy(networks(slot).parameters))
        model.rollout_buffer = Batches(*experience(slot, epochs=5))
        model.train()
        ours, theirs = stacked.networks(slot), ppo_parameters(model).values.numpy()
        assert np.abs(ours.parameters - theirs).max() < 1e-9
        assert np.abs(ours.parameters - networks(slot).parameters).max() > 1e-3
        assert ours.step == 10
        logged = model.logger.name_to_value
        figures = stacked.figures(slot)
        assert figures.pop("approx_kl") > 0  # theirs is of the last epoch only
        for name, value in figures.items():
            np.testing.assert_allclose(value, logged[f"train/{name}"], rtol=1e-5, atol=1e-7)


def test_a_run_learns_the_same_bits_whoever_its_neighbours_are():
    expected = alone()
    stacked = StackedPPO((OBSERVATION, ACTION), HYPER, WIDTH, CPU)
    for slot in (0, 1):
        stacked.join(slot, networks(slot))
    for seed in range(9):
        learn(stacked, 1, seed)
        if seed < 6:
            learn(stacked, 0, seed + 20)
        if seed == 6:  # half-way: one has gone, another comes
            stacked.leave(0)
            stacked.join(2, networks(7))
        if seed >= 6:
            stacked.advance(2)
            learn(stacked, 2, seed)
        while stacked.owed[1]:
            stacked.advance(3)
        stacked.advance(100)
    assert_same_bits(stacked.networks(1), expected)


@pytest.mark.parametrize("slot", [0, 2])
def test_a_run_learns_the_same_bits_in_every_slot(slot):
    assert_same_bits(alone(slot), alone(1))


def test_an_idle_run_does_not_change_and_a_diverged_neighbour_harms_nobody():
    stacked = StackedPPO((OBSERVATION, ACTION), HYPER, WIDTH, CPU)
    broken = networks(0)
    broken.parameters[:] = np.nan
    for slot, own in enumerate((broken, networks(1), networks(2))):
        stacked.join(slot, own)
    before = stacked.networks(2)
    for seed in range(9):
        for slot in (0, 1):
            learn(stacked, slot, seed)
        stacked.advance(100)
    assert_same_bits(stacked.networks(2), before)
    assert_same_bits(stacked.networks(1), alone())
    learn(stacked, 2, 1)
    stacked.advance(1)
    assert np.isnan(stacked.networks(0).parameters).any()
    assert np.isfinite(stacked.networks(2).parameters).all()
    stacked.leave(0)
    assert not stacked.networks(0).parameters.any()


def test_padding_stays_zero_and_a_run_goes_on_elsewhere():
    stacked, other = (StackedPPO((OBSERVATION, ACTION), HYPER, WIDTH, CPU) for _ in range(2))
    stacked.join(0, networks(1))
    learn(stacked, 0, 5)
    stacked.advance(100)
    for memory, places in stacked._stacks():
        rows = memory.detach().clone()
        assert rows[..., places].any()
        rows[..., places] = 0
        assert not rows.any()
    other.join(2, stacked.networks(0))
    for own, slot in ((stacked, 0), (other, 2)):
        learn(own, slot, 6)
        own.advance(100)
    assert_same_bits(other.networks(2), stacked.networks(0))
    np.testing.assert_array_equal(other.actors([2, 0])[0].numpy(), other.networks(2).parameters)


def test_bfloat16_layers_are_close_to_float32_ones_and_differ():
    precise, rounded = alone(), alone(hyper=PPOHyperparameters(**SIZES, epochs=3, matmul_precision="medium"))
    difference = np.abs(precise.parameters - rounded.parameters).mean()
    moved = np.abs(precise.parameters - networks(1).parameters).mean()
    assert 0 < difference < 0.2 * moved


@pytest.mark.slow
def test_compiled_updates_are_the_same_up_to_rounding():
    plain, stacked = (
        StackedPPO((OBSERVATION, ACTION), HYPER, WIDTH, CPU, compiled=mode) for mode in (False, "default")
    )
    for own in (plain, stacked):
        for slot in range(WIDTH):
            own.join(slot, networks(slot))
        learn(own, 1, 1)
        learn(own, 2, 2)
        own.advance(100)
    for slot in range(WIDTH):
        ours, theirs = stacked.networks(slot).parameters, plain.networks(slot).parameters
        np.testing.assert_allclose(ours, theirs, atol=1e-4)
    assert_same_bits(stacked.networks(0), plain.networks(0))
