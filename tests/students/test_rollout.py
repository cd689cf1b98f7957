import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3.common.buffers import RolloutBuffer

from tma_ray.students.players.ppo import Rollout


def filled(steps: int, ended, judged, rewards=None) -> Rollout:
    rng = np.random.default_rng(0)
    rollout = Rollout(steps, 3, 2, np.random.default_rng(7), torch.device("cpu"))
    for index in range(steps):
        reward = rng.normal() if rewards is None else rewards[index]
        rollout.add(rng.normal(size=3), rng.normal(size=2), reward, bool(ended[index]), judged[index])
    return rollout


@pytest.mark.parametrize("last_ended", [False, True])
def test_returns_and_advantages_equal_stable_baselines3_to_the_last_bit(last_ended):
    steps = 200
    ended = np.random.default_rng(1).random(steps) < 0.1
    ended[-1] = last_ended
    values, log_probabilities = np.random.default_rng(2).normal(size=(2, steps)).astype(np.float32)
    ours = filled(steps, ended, list(zip(values, log_probabilities, strict=True)))
    box = spaces.Box(-1, 1, (3,)), spaces.Box(-1, 1, (2,))
    stock = RolloutBuffer(steps, *box, device="cpu", gae_lambda=0.95, gamma=0.99)
    for index in range(steps):
        start = np.array([index == 0 or ended[index - 1]])
        value, probability = (torch.tensor([column[index]]) for column in (values, log_probabilities))
        stock.add(
            ours.observations[None, index],
            ours.actions[None, index],
            ours.rewards[None, index],
            start,
            value,
            probability,
        )
    stock.compute_returns_and_advantage(torch.tensor([[0.3]]), dones=np.array([last_ended]))
    ours.finish(0.3, gamma=0.99, gae_lambda=0.95)
    np.testing.assert_array_equal(ours.advantages, stock.advantages[:, 0])
    np.testing.assert_array_equal(ours.returns, stock.returns[:, 0])


def test_lambda_one_gives_discounted_returns():
    rewards = [1.0, 2.0, 4.0, 8.0]
    judged = [(value, 0.0) for value in (5, 6, 7, 8)]
    rollout = filled(4, [False, True, False, False], judged, rewards)
    rollout.finish(last_value=16.0, gamma=0.5, gae_lambda=1.0)
    np.testing.assert_allclose(rollout.returns, [1 + 0.5 * 2, 2, 4 + 0.5 * (8 + 0.5 * 16), 8 + 0.5 * 16])


def test_lambda_zero_gives_one_step_errors():
    rollout = filled(3, [False, True, False], [(5, 0.0), (6, 0.0), (7, 0.0)], [1.0, 2.0, 4.0])
    rollout.finish(last_value=16.0, gamma=0.5, gae_lambda=0.0)
    np.testing.assert_allclose(rollout.advantages, [1 + 3 - 5, 2 - 6, 4 + 8 - 7])


def test_mini_batches_hold_every_step_once_in_a_new_order_each_time():
    rollout = filled(10, [False] * 10, [(0.0, index) for index in range(10)])
    rollout.finish(0.0, 0.99, 0.95)
    orders = []
    for _ in range(2):
        batches = list(rollout.get(5))
        assert [len(batch.actions) for batch in batches] == [5, 5]
        orders.append(torch.cat([batch.old_log_prob for batch in batches]).tolist())
        assert sorted(orders[-1]) == list(range(10))
    assert orders[0] != orders[1]
