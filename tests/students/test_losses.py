"""Losses and updates against stable-baselines3's own `train`, and of stacked runs against single ones."""

import numpy as np
import pytest
import torch
from stable_baselines3.common.type_aliases import ReplayBufferSamples, RolloutBufferSamples
from stock_models import ACTION, OBSERVATION, Batches, ppo, ppo_parameters, sac

from tma_ray.students.hyperparameters import LogStd, PPOHyperparameters, SACHyperparameters
from tma_ray.students.mlp.network import FlatParameters, blocks_of
from tma_ray.students.ppo import PPOUpdate, Steps, losses
from tma_ray.students.rollout_workers.sac import LOG_STD_RANGE
from tma_ray.students.sac import SQUASH_EPSILON, SACUpdate, log_std_of, squashed_draw

pytestmark = pytest.mark.usefixtures("_seeded")
UPDATES = 10
KINDS = [(torch.float64, 1e-9), (torch.float32, 2e-5)]
DTYPES = pytest.mark.parametrize(("dtype", "tolerance"), KINDS, ids=["float64", "float32"])


def largest_difference(model, stock) -> float:
    ours, theirs = model.policy.state_dict(), stock.policy.state_dict()
    return max((ours[name] - theirs[name]).abs().max().item() for name in theirs)


def random(*shape, dtype):
    """Normal numbers that float32 has, too: stable-baselines3 rounds observations to it."""
    return torch.randn(*shape).to(dtype)


def rollouts(model, dtype, batch_size: int = 40) -> list[RolloutBufferSamples]:
    observations = random(batch_size, OBSERVATION, dtype=dtype)
    actions = random(batch_size, ACTION, dtype=dtype)
    with torch.no_grad():
        values, log_probabilities, _ = model.policy.evaluate_actions(observations, actions)
    shaken = log_probabilities + 0.3 * random(batch_size, dtype=dtype)  # on both sides of the clip
    advantages, returns = random(2, batch_size, dtype=dtype)
    old_values = values[:, 0] + 0.3 * random(batch_size, dtype=dtype)
    return [RolloutBufferSamples(observations, actions, old_values, shaken, advantages, returns)]


@DTYPES
@pytest.mark.parametrize("value_clip_range", [0.2, None])
@pytest.mark.parametrize("max_gradient_norm", [0.05, 50.0])
def test_ppo_equals_stock_after_ten_updates(dtype, tolerance, value_clip_range, max_gradient_norm):
    sizes = {"hidden_units": (40, 30), "steps_per_update": 40, "batch_size": 40, "epochs": 1}
    clips = {"value_clip_range": value_clip_range, "max_gradient_norm": max_gradient_norm}
    hyper = PPOHyperparameters(entropy_coefficient=0.01, **sizes, **clips)
    model, stock = ppo(hyper, dtype), ppo(hyper, dtype)
    stock.policy.load_state_dict(model.policy.state_dict())
    initial = ppo(hyper, dtype)
    initial.policy.load_state_dict(model.policy.state_dict())
    update = PPOUpdate(model, ppo_parameters(model), hyper)
    for _ in range(UPDATES):
        stock.rollout_buffer = Batches([rollouts(stock, dtype)])
        update(stock.rollout_buffer)
        stock.train()
    assert largest_difference(model, stock) < tolerance
    assert largest_difference(initial, stock) > 1e-3
    assert model._n_updates == stock._n_updates == UPDATES
    ours, theirs = model.logger.name_to_value, stock.logger.name_to_value
    for name in ("policy_gradient_loss", "value_loss", "approx_kl", "clip_fraction", "std"):
        np.testing.assert_allclose(ours[f"train/{name}"], theirs[f"train/{name}"], rtol=1e-3, atol=1e-5)


def sac_update(model, hyper: SACHyperparameters) -> SACUpdate:
    actor, critics = model.actor, model.critic.q_networks
    blocks = blocks_of(actor.latent_pi, actor.mu, actor.log_std)
    return SACUpdate(model, FlatParameters([blocks]), FlatParameters([*map(blocks_of, critics)]), hyper)


def transitions(dtype, batch_size: int = 50) -> ReplayBufferSamples:
    widths = (OBSERVATION, ACTION, OBSERVATION, 1, 1)
    first, actions, following, dones, rewards = (random(batch_size, width, dtype=dtype) for width in widths)
    return ReplayBufferSamples(first, actions.tanh(), following, (dones > 1).to(dtype), rewards)


@DTYPES
@pytest.mark.parametrize(
    ("log_std", "spread", "rate"),
    [(LogStd.CLAMP, 0.0, 1e-3), (LogStd.CLAMP, 2.0, 1e-4), (LogStd.TANH, 1.0, 1e-3)],
    ids=["clamp", "beyond-the-clamp", "tanh"],
)
def test_sac_equals_stock_after_ten_updates(dtype, tolerance, log_std, spread, rate):
    values = {"learning_rate": rate, "log_std": log_std}
    hyper = SACHyperparameters(hidden_units=(40, 30), entropy_coefficient=0.2, **values)
    model, stock = sac(hyper, dtype), sac(hyper, dtype)
    with torch.no_grad():
        model.actor.log_std.bias += spread  # some log deviations are over their bound then
    stock.policy.load_state_dict(model.policy.state_dict())
    initial = {name: value.clone() for name, value in model.policy.state_dict().items()}
    update = sac_update(model, hyper)
    for number in range(UPDATES):
        batch = transitions(dtype)
        stock.replay_buffer.sample = lambda size, env=None, batch=batch: batch
        for train in (lambda batch=batch: update(batch), lambda: stock.train(1, 50)):
            torch.manual_seed(number)
            train()
    assert largest_difference(model, stock) < tolerance
    moved = {name: (value - initial[name]).abs().max() for name, value in stock.policy.state_dict().items()}
    assert min(moved.values()) > rate / 100
    assert model._n_updates == stock._n_updates == UPDATES
    ours, theirs = model.logger.name_to_value, stock.logger.name_to_value
    for name in ("train/actor_loss", "train/critic_loss"):
        np.testing.assert_allclose(ours[name], theirs[name], rtol=1e-4)


def total(parts, log_std, hyper: PPOHyperparameters) -> torch.Tensor:
    """Return the loss (k,) that PPO minimises, for autograd to differentiate."""
    entropy = torch.distributions.Normal(0, log_std.exp()).entropy().sum(dim=-1)
    return parts.policy + hyper.value_coefficient * parts.value - hyper.entropy_coefficient * entropy


@pytest.mark.parametrize("value_clip_range", [0.2, None])
@pytest.mark.parametrize("runs", [(), (3,)], ids=["alone", "stacked"])
def test_ppos_gradient_is_autograds(runs, value_clip_range):
    hyper = PPOHyperparameters(entropy_coefficient=0.01, value_clip_range=value_clip_range)
    shapes = ((50, OBSERVATION), (50, ACTION), (50,), (50,), (50,), (50,))
    steps = Steps(*(0.5 * random(*runs, *shape, dtype=torch.float64) for shape in shapes))
    outputs = (0.5 * random(*runs, 50, ACTION + 1, dtype=torch.float64)).requires_grad_()
    log_std = (0.3 * random(*runs, ACTION, dtype=torch.float64)).requires_grad_()
    old = torch.distributions.Normal(outputs[..., :-1], log_std.exp()[..., None, :]).log_prob(steps.actions)
    steps = steps._replace(old_log_prob=old.sum(dim=-1).detach() + 0.3 * steps.old_log_prob)
    parts = losses(outputs, log_std, steps, hyper)
    by_outputs, by_log_std = torch.autograd.grad(total(parts, log_std, hyper).sum(), (outputs, log_std))
    torch.testing.assert_close(parts.outputs_gradient, by_outputs, rtol=1e-10, atol=1e-14)
    torch.testing.assert_close(parts.log_std_gradient, by_log_std, rtol=1e-10, atol=1e-14)
    assert parts.clipped.min() > 0  # both sides of the clipping are met
    assert parts.clipped.max() < 1


@pytest.mark.parametrize("log_std", list(LogStd))
def test_a_squashed_draw_is_that_of_a_transformed_normal_distribution(log_std):
    """Actions, densities and their gradients against torch's distributions and finite differences."""
    low, high = LOG_STD_RANGE
    outputs, noise = random(30, 2 * ACTION, dtype=torch.float64), random(30, ACTION, dtype=torch.float64)
    outputs[:, :ACTION] *= 0.3
    outputs[:, ACTION:] = 0.3 * outputs[:, ACTION:] + (0.8 if log_std is LogStd.TANH else 0)
    outputs.requires_grad_()
    draw = squashed_draw(outputs, noise, log_std)

    means, heads = outputs[:, :ACTION], outputs[:, ACTION:]
    middle, half = (low + high) / 2, (high - low) / 2
    log_deviations = middle + half * torch.tanh(heads) if log_std is LogStd.TANH else heads
    normal = torch.distributions.Normal(means, log_deviations.exp())
    before = means + normal.stddev * noise
    squashing = torch.log(1 - torch.tanh(before) ** 2 + SQUASH_EPSILON)
    expected = (normal.log_prob(before) - squashing).sum(dim=1, keepdim=True)
    torch.testing.assert_close(draw.actions, before.tanh(), rtol=1e-9, atol=1e-12)
    torch.testing.assert_close(draw.log_probabilities, expected, rtol=1e-8, atol=1e-8)
    mine, plain = (torch.autograd.grad(d.sum(), outputs)[0] for d in (draw.log_probabilities, expected))
    torch.testing.assert_close(mine, plain, rtol=1e-6, atol=1e-6)
    assert torch.autograd.gradcheck(lambda values: squashed_draw(values, noise, log_std), outputs)


def test_the_log_deviation_of_a_new_policy_is_about_minus_nine_and_within_its_range():
    model = sac(SACHyperparameters(), torch.float32)
    seen = random(100, OBSERVATION, dtype=torch.float32)
    with torch.no_grad():
        log_deviations = model.actor.get_action_dist_params(seen)[1]
        extreme = log_std_of(torch.tensor([-1e9, 0.0, 1e9]), LogStd.TANH)
    assert (log_deviations + 9).abs().mean() < 1
    torch.testing.assert_close(extreme, torch.tensor([-20.0, -9.0, 2.0]))
