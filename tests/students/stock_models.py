"""Models of stable-baselines3 equivalent to the students, in float32 or float64."""

from itertools import cycle

import numpy as np
import stable_baselines3
import torch
from gymnasium import spaces
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn

from tma_ray.students.hyperparameters import PPOHyperparameters, SACHyperparameters
from tma_ray.students.mlp.network import FlatParameters, blocks_of
from tma_ray.students.ppo import Trunk
from tma_ray.students.sac import POLICIES
from tma_ray.students.sb3.algorithms import SpacesOnly

OBSERVATION, ACTION = 5, 3


def world() -> SpacesOnly:
    return SpacesOnly(spaces.Box(-1, 1, (OBSERVATION,)), spaces.Box(-1, 1, (ACTION,)))


class Batches:
    """Substitute for a rollout buffer that repeats the mini-batches of given epochs."""

    def __init__(self, epochs) -> None:
        self.epochs = cycle(epochs)
        self.values = self.returns = np.ones(4)

    def get(self, batch_size):
        return iter(next(self.epochs))


def convert(model, dtype) -> None:
    model.policy.to(dtype)
    for module in model.policy.modules():
        if isinstance(module, BaseFeaturesExtractor):
            module.register_forward_pre_hook(lambda _, inputs: inputs[0].to(dtype))


def ppo(hyper: PPOHyperparameters, dtype) -> stable_baselines3.PPO:
    sizes = {"n_steps": hyper.steps_per_update, "batch_size": hyper.batch_size, "n_epochs": hyper.epochs}
    clips = {"clip_range": hyper.clip_range, "clip_range_vf": hyper.value_clip_range}
    weights = {"ent_coef": hyper.entropy_coefficient, "vf_coef": hyper.value_coefficient}
    rates = {"learning_rate": hyper.learning_rate, "max_grad_norm": hyper.max_gradient_norm}
    trunk = {"hidden_units": hyper.layout(OBSERVATION, ACTION).sizes[1:-1], "activation": hyper.activation}
    network = {"net_arch": [], "features_extractor_class": Trunk, "features_extractor_kwargs": trunk}
    options = {**sizes, **clips, **weights, **rates, "policy_kwargs": network}
    model = stable_baselines3.PPO("MlpPolicy", world(), device="cpu", **options)
    convert(model, dtype)
    if hyper.separate_trunks:
        flat = ppo_parameters(model)
        kept = torch.ones_like(flat.values)
        kept[:-ACTION] = torch.from_numpy(hyper.layout(OBSERVATION, ACTION).trunks(ACTION)).to(dtype)
        for parameter, own in zip(flat.parameters, flat.views(kept), strict=True):
            parameter.register_hook(own.mul)
    nn.init.normal_(model.policy.log_std, std=0.3)
    model.set_logger(Logger(None, []))
    return model


def ppo_parameters(model) -> FlatParameters:
    policy = model.policy
    blocks = blocks_of(policy.features_extractor, policy.action_net, policy.value_net)
    return FlatParameters([blocks], others=[policy.log_std])


def sac(hyper: SACHyperparameters, dtype) -> stable_baselines3.SAC:
    rates = {"learning_rate": hyper.learning_rate, "tau": hyper.target_rate}
    network = {"policy_kwargs": {"net_arch": list(hyper.hidden_units)}, "ent_coef": hyper.entropy_coefficient}
    model = stable_baselines3.SAC(
        POLICIES[hyper.log_std], world(), buffer_size=1, device="cpu", **rates, **network
    )
    convert(model, dtype)
    model.ent_coef_tensor = model.ent_coef_tensor.to(dtype)
    model.set_logger(Logger(None, []))
    return model
