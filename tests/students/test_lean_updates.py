"""The hand-written updates against autograd and against stable-baselines3's own `train`."""

import copy

import numpy as np
import pytest
import stable_baselines3
import torch
from gymnasium import spaces
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.type_aliases import ReplayBufferSamples, RolloutBufferSamples
from torch import nn

from tma_ray.students.hyperparameters import PPOHyperparameters, SACHyperparameters
from tma_ray.students.networks import Trunk
from tma_ray.students.perceptron import FlatParameters, blocks_of
from tma_ray.students.ppo.update import PPOUpdate
from tma_ray.students.sac.update import SACUpdate
from tma_ray.students.sb3.algorithm_models import SpacesOnly

UPDATES, OBSERVATION, ACTION = 10, 5, 3
DTYPES = pytest.mark.parametrize(
    ("dtype", "tolerance"), [(torch.float64, 1e-9), (torch.float32, 2e-5)], ids=["float64", "float32"]
)


def world() -> SpacesOnly:
    return SpacesOnly(spaces.Box(-1, 1, (OBSERVATION,)), spaces.Box(-1, 1, (ACTION,)))


def largest_difference(model, stock) -> float:
    ours, theirs = model.policy.state_dict(), stock.policy.state_dict()
    return max((ours[name] - theirs[name]).abs().max().item() for name in theirs)


def random(*shape, dtype):
    """Normal numbers that float32 has, too: stable-baselines3 rounds observations to it."""
    return torch.randn(*shape).to(dtype)


def convert(model, dtype) -> None:
    model.policy.to(dtype)
    for module in model.policy.modules():
        if isinstance(module, BaseFeaturesExtractor):
            module.register_forward_pre_hook(lambda _, inputs: inputs[0].to(dtype))


@pytest.fixture(autouse=True)
def _seeded():
    with torch.random.fork_rng():
        torch.manual_seed(4)
        yield


class Batches:
    """Stands in for a rollout buffer: the same mini-batches every time."""

    def __init__(self, batches):
        self.batches = batches
        self.values = self.returns = np.ones(4)

    def get(self, batch_size):
        return iter(self.batches)


def ppo(hyper: PPOHyperparameters, dtype) -> stable_baselines3.PPO:
    model = stable_baselines3.PPO(
        "MlpPolicy",
        world(),
        learning_rate=hyper.learning_rate,
        n_steps=hyper.steps_per_update,
        batch_size=hyper.batch_size,
        n_epochs=hyper.epochs,
        clip_range=hyper.clip_range,
        clip_range_vf=hyper.value_clip_range,
        ent_coef=hyper.entropy_coefficient,
        vf_coef=hyper.value_coefficient,
        max_grad_norm=hyper.max_gradient_norm,
        policy_kwargs={
            "net_arch": [],
            "features_extractor_class": Trunk,
            "features_extractor_kwargs": {"hidden_units": hyper.hidden_units},
        },
        device="cpu",
    )
    convert(model, dtype)
    nn.init.normal_(model.policy.log_std, std=0.3)
    model.set_logger(Logger(None, []))
    return model


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
    hyper = PPOHyperparameters(
        hidden_units=(40, 30),
        steps_per_update=40,
        batch_size=40,
        epochs=1,
        entropy_coefficient=0.01,
        value_clip_range=value_clip_range,
        max_gradient_norm=max_gradient_norm,
    )
    model, stock = ppo(hyper, dtype), ppo(hyper, dtype)
    stock.policy.load_state_dict(model.policy.state_dict())
    initial = ppo(hyper, dtype)
    initial.policy.load_state_dict(model.policy.state_dict())
    update = PPOUpdate(model, hyper)
    for _ in range(UPDATES):
        stock.rollout_buffer = Batches(rollouts(stock, dtype))
        update(stock.rollout_buffer)
        stock.train()
    assert largest_difference(model, stock) < tolerance
    assert largest_difference(initial, stock) > 1e-3
    assert model._n_updates == stock._n_updates == UPDATES
    ours, theirs = model.logger.name_to_value, stock.logger.name_to_value
    for name in ("policy_gradient_loss", "value_loss", "approx_kl", "clip_fraction", "std"):
        np.testing.assert_allclose(ours[f"train/{name}"], theirs[f"train/{name}"], rtol=1e-3, atol=1e-5)


def sac(hyper: SACHyperparameters, dtype) -> stable_baselines3.SAC:
    model = stable_baselines3.SAC(
        "MlpPolicy",
        world(),
        learning_rate=hyper.learning_rate,
        tau=hyper.target_rate,
        ent_coef=hyper.entropy_coefficient,
        buffer_size=1,
        policy_kwargs={"net_arch": list(hyper.hidden_units)},
        device="cpu",
    )
    convert(model, dtype)
    model.ent_coef_tensor = model.ent_coef_tensor.to(dtype)
    model.set_logger(Logger(None, []))
    return model


def transitions(dtype, batch_size: int = 50) -> ReplayBufferSamples:
    return ReplayBufferSamples(
        random(batch_size, OBSERVATION, dtype=dtype),
        random(batch_size, ACTION, dtype=dtype).tanh(),
        random(batch_size, OBSERVATION, dtype=dtype),
        (random(batch_size, 1, dtype=dtype) > 1).to(dtype),
        random(batch_size, 1, dtype=dtype),
    )


@DTYPES
@pytest.mark.parametrize(("spread", "rate"), [(0.0, 1e-3), (2.0, 1e-4)], ids=["usual", "beyond-the-clamp"])
def test_sac_equals_stock_after_ten_updates(dtype, tolerance, spread, rate):
    hyper = SACHyperparameters(hidden_units=(40, 30), learning_rate=rate, entropy_coefficient=0.2)
    model, stock = sac(hyper, dtype), sac(hyper, dtype)
    with torch.no_grad():
        model.actor.log_std.bias += spread  # some log deviations are over their bound then
    stock.policy.load_state_dict(model.policy.state_dict())
    initial = {name: value.clone() for name, value in model.policy.state_dict().items()}
    update = SACUpdate(model, hyper)
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


def test_backward_equals_autograd():
    module = nn.Sequential(nn.Linear(5, 7), nn.ReLU(), nn.Linear(7, 6), nn.ReLU()).double()
    heads = nn.Linear(6, 2).double(), nn.Linear(6, 1).double()
    inputs, outer = random(9, 5, dtype=torch.float64).requires_grad_(), random(9, 3, dtype=torch.float64)
    features = module(inputs)
    expected = torch.cat([head(features) for head in heads], dim=1)
    parameters = [*module.parameters(), *heads[0].parameters(), *heads[1].parameters()]
    gradients = torch.autograd.grad(expected, [inputs, *parameters], outer)
    by_parameter = dict(zip(map(id, parameters), gradients[1:], strict=True))
    flat = FlatParameters([blocks_of(module, *heads)])
    with torch.no_grad():
        (network,) = flat.networks
        torch.testing.assert_close(network.forward(inputs.detach()), expected, rtol=0, atol=1e-12)
        rows = torch.tensor([1, 4, 8])
        torch.testing.assert_close(network.input_gradient(outer[rows], rows), gradients[0][rows])
        assert not flat.gradient.any()
        network.backward(outer)
    for parameter, gradient in zip(flat.parameters, flat.views(flat.gradient), strict=True):
        torch.testing.assert_close(gradient, by_parameter[id(parameter)], rtol=0, atol=1e-12)


def test_stock_goes_on_from_a_lean_optimisers_state():
    hyper = SACHyperparameters(hidden_units=(8, 6))
    model, stock = sac(hyper, torch.float64), sac(hyper, torch.float64)
    update = SACUpdate(model, hyper)
    for _ in range(3):
        update(transitions(torch.float64))
    stock.set_parameters(copy.deepcopy(model.get_parameters()))
    batch = transitions(torch.float64)
    stock.replay_buffer.sample = lambda size, env=None: batch
    for train in (lambda: update(batch), lambda: stock.train(1, 50)):
        torch.manual_seed(0)
        train()
    assert largest_difference(model, stock) < 1e-9
    assert {float(state["step"]) for state in stock.actor.optimizer.state.values()} == {4.0}
