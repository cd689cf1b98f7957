"""Stacked PPO: stable-baselines3's update in every slot."""

import numpy as np
import pytest
import torch
from stable_baselines3.common.type_aliases import RolloutBufferSamples
from stacked_runs import PPO, WIDTH, enter
from stock_models import Batches, ppo, ppo_parameters

from tma_ray.students.hyperparameters import PPOHyperparameters
from tma_ray.students.mlp.layout import Activation

pytestmark = pytest.mark.usefixtures("_both_ways")


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
def test_every_slot_equals_stock_after_ten_updates(values):
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
