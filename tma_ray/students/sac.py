"""SAC on top of stable-baselines3, with the paper's hyper-parameters."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import stable_baselines3
import torch
from numpy.typing import NDArray
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.type_aliases import PyTorchObs, ReplayBufferSamples
from stable_baselines3.sac.policies import Actor, SACPolicy
from torch import nn

from tma_ray.students.base import Actions, Observations, Policy, Transition
from tma_ray.students.hyperparameters import LogStd, SACHyperparameters
from tma_ray.students.layers import (
    GreedyNetwork,
    as_sequential,
    check_rows,
    stored_network,
    stored_parameters,
    tensor_specs,
    unscale,
)
from tma_ray.students.mlp.network import FlatAdam, FlatParameters, as_batch, as_modules, blocks_of
from tma_ray.students.policy_files import read_policy, write_policy
from tma_ray.students.replay import ReplayBuffer
from tma_ray.students.rollout_workers.sac import LOG_STD_RANGE, SQUASH_EPSILON, SACActing, rescale
from tma_ray.students.sb3.base import StableBaselinesStudent

_HALF_LOG_2PI = 0.5 * math.log(2 * math.pi)

Pass: TypeAlias = Callable[[torch.Tensor], torch.Tensor]  # forward pass of a network


class Transitions(NamedTuple):
    """A batch of n transitions, with the same fields as stable-baselines3's samples.

    Attributes:
        observations: observations (n, o).
        actions: actions in [-1, 1] (n, a).
        next_observations: observations after the steps (n, o).
        dones: 1 at terminal states, else 0 (n, 1).
        rewards: rewards (n, 1).
    """

    observations: torch.Tensor
    actions: torch.Tensor
    next_observations: torch.Tensor
    dones: torch.Tensor
    rewards: torch.Tensor


class Draw(NamedTuple):
    """Sampled actions in [-1, 1] (n, a) and their log probabilities (n, 1)."""

    actions: torch.Tensor
    log_probabilities: torch.Tensor


def log_std_of(outputs: torch.Tensor, log_std: LogStd) -> torch.Tensor:
    """Map an actor's `outputs` to log standard deviations within `LOG_STD_RANGE`."""
    low, high = LOG_STD_RANGE
    if log_std is LogStd.CLAMP:
        return outputs.clamp(low, high)
    return low + 0.5 * (high - low) * (outputs.tanh() + 1)


def squashed_draw(outputs: torch.Tensor, noise: torch.Tensor, log_std: LogStd) -> Draw:
    """Return actions sampled from a tanh-squashed normal distribution, with their log density.

    Args:
        outputs: outputs of an actor (n, 2a).
        noise: standard normal noise (n, a).
        log_std: map from outputs to log standard deviations.
    """
    mean, log_deviation = outputs.chunk(2, dim=-1)
    log_deviation = log_std_of(log_deviation, log_std)
    actions = (mean + log_deviation.exp() * noise).tanh()
    log_density = -0.5 * noise.square() - log_deviation - _HALF_LOG_2PI
    log_squashing = (1 - actions.square() + SQUASH_EPSILON).log()
    return Draw(actions, (log_density - log_squashing).sum(dim=-1, keepdim=True))


def joint_pass(critics: Sequence[Pass]) -> Pass:
    """Return a function that concatenates the outputs of c `critics` to (n, c)."""
    return lambda inputs: torch.cat([critic(inputs) for critic in critics], dim=-1)


def soft_values(critics: Pass, observations: torch.Tensor, draw: Draw, alpha: float) -> torch.Tensor:
    """Return min Q - alpha log pi (n, 1) for the actions in `draw`."""
    values = critics(torch.cat((observations, draw.actions), dim=-1))
    return values.min(dim=-1, keepdim=True).values - alpha * draw.log_probabilities


def critic_loss(critics: Pass, batch: Transitions, targets: torch.Tensor) -> torch.Tensor:
    """Return half the mean squared error of each critic, summed over the critics.

    The `targets` are r + gamma (1 - done) V(s') (n, 1), without a gradient.
    """
    values = critics(torch.cat((batch.observations, batch.actions), dim=-1))
    return 0.5 * (values - targets).square().mean(dim=-2).sum(dim=-1)


def actor_loss(critics: Pass, observations: torch.Tensor, draw: Draw, alpha: float) -> torch.Tensor:
    """Return the mean of alpha log pi - min Q over the actor's sampled actions in `draw`."""
    return -soft_values(critics, observations, draw, alpha).mean(dim=(-2, -1))


class TanhActor(Actor):
    """Actor whose log standard deviation is limited by a scaled tanh instead of clamping."""

    def get_action_dist_params(
        self, obs: PyTorchObs
    ) -> tuple[torch.Tensor, torch.Tensor, dict[str, torch.Tensor]]:
        """Return means and log standard deviations (n, a) of the actions before squashing."""
        latent = self.latent_pi(self.extract_features(obs, self.features_extractor))
        log_std: Any = self.log_std
        return self.mu(latent), log_std_of(log_std(latent), LogStd.TANH), {}


class TanhPolicy(SACPolicy):
    """SAC policy with a `TanhActor`."""

    def make_actor(self, features_extractor: BaseFeaturesExtractor | None = None) -> Actor:
        """Return a new actor."""
        keywords = self._update_features_extractor(self.actor_kwargs, features_extractor)
        return TanhActor(**keywords).to(self.device)


POLICIES: dict[LogStd, type[SACPolicy]] = {LogStd.TANH: TanhPolicy, LogStd.CLAMP: SACPolicy}
"""Policy class for each map to the log standard deviation."""


class SACUpdate:
    """SAC's update, applied to a stable-baselines3 model that owns the networks and optimiser states."""

    def __init__(
        self,
        model: stable_baselines3.SAC,
        actor: FlatParameters,
        critics: FlatParameters,
        hyperparameters: SACHyperparameters,
    ) -> None:
        self.actor, self.critics = actor, critics
        self.targets = FlatParameters([blocks_of(network) for network in model.critic_target.q_networks])
        self.actor_adam = FlatAdam(model.actor.optimizer, self.actor)
        self.critic_adam = FlatAdam(model.critic.optimizer, self.critics)
        self._model, self._hyper = model, hyperparameters

    def __call__(self, samples: ReplayBufferSamples) -> None:
        """Update the critics, actor and targets once, with noise from torch's generator."""
        batch = Transitions(*samples[:5])
        noise, next_noise = (torch.randn_like(batch.actions) for _ in range(2))
        hyper, (actor,) = self._hyper, self.actor.networks
        with torch.no_grad():
            draw = squashed_draw(actor(batch.next_observations), next_noise, hyper.log_std)
            targets = joint_pass([network.frozen for network in self.targets.networks])
            values = soft_values(targets, batch.next_observations, draw, hyper.entropy_coefficient)
            goals = batch.rewards + (1 - batch.dones) * hyper.gamma * values
        critics_loss = critic_loss(joint_pass(self.critics.networks), batch, goals)
        self.critics.differentiate(critics_loss)
        self.critic_adam.step()
        critics = joint_pass([network.frozen for network in self.critics.networks])
        draw = squashed_draw(actor(batch.observations), noise, hyper.log_std)
        policy_loss = actor_loss(critics, batch.observations, draw, hyper.entropy_coefficient)
        self.actor.differentiate(policy_loss)
        self.actor_adam.step()
        self.targets.values.lerp_(self.critics.values, hyper.target_rate)
        self._model._n_updates += 1
        self._model.logger.record("train/critic_loss", critics_loss.item())
        self._model.logger.record("train/actor_loss", policy_loss.item())


POLICY = "sac"  # name of the student in saved policies, including those of `StockSAC`


class SAC(SACActing, StableBaselinesStudent[SACHyperparameters, stable_baselines3.SAC]):
    """Soft actor-critic with a fixed entropy coefficient, as in Spinning Up 0.1.1 (cited by the paper).

    The first 10,000 actions of the run are uniform. At the end of each episode, from the first one on,
    the networks are updated once for every 10 of its steps, rounded up; an episode cut off by the run's
    budget brings no updates. Batches are drawn with replacement, also from fewer transitions than a batch
    has. Time limits bootstrap. The greedy action is the squashed mean. It has no V network (the original
    release has one): V(s) = E[min Q(s, a) - alpha log pi(a|s)] is averaged over sampled actions.
    """

    _acting: GreedyNetwork

    def _make_model(self) -> stable_baselines3.SAC:
        hyper = self.hyperparameters
        model = stable_baselines3.SAC(
            POLICIES[hyper.log_std],
            env=None,  # type: ignore[arg-type]  # stepped by the run, not by the model
            learning_rate=hyper.learning_rate,
            buffer_size=hyper.buffer_size,
            learning_starts=hyper.exploration_steps,
            batch_size=hyper.batch_size,
            tau=hyper.target_rate,
            gamma=hyper.gamma,
            train_freq=hyper.steps_per_update,
            gradient_steps=1,
            ent_coef=hyper.entropy_coefficient,
            target_entropy=0.0,  # unused, since the coefficient is fixed
            policy_kwargs={"net_arch": list(hyper.hidden_units), "activation_fn": nn.ReLU},
            device=self.device,
            _init_setup_model=False,
        )
        model.replay_buffer = self.replay  # type: ignore[assignment]
        return model

    def _start(self) -> None:
        super()._start()
        sizes = self.observation_space.shape[0], self.action_space.shape[0]
        self.replay = ReplayBuffer(self.hyperparameters.buffer_size, *sizes, self._batches, self.device)

    def _connect(self) -> None:
        actor, critics = self.model.actor, self.model.critic.q_networks
        self.replay.clear()
        self._actor = FlatParameters([blocks_of(actor.latent_pi, actor.mu, actor.log_std)])  # type: ignore[arg-type]
        self._critics = FlatParameters([blocks_of(critic) for critic in critics])
        self._acting = GreedyNetwork(self._actor.values, self._actor.networks[0].layout, self._low.size)

    def _refresh(self) -> None:
        self._acting.refresh()

    def _prepare_update(self) -> None:
        # code that changes parameters by `update` must call `changed`
        self.update = SACUpdate(self.model, self._actor, self._critics, self.hyperparameters)

    def _train(self, updates: int) -> None:
        for _ in range(updates):
            self.update(self.replay.sample(self.hyperparameters.batch_size))

    def observe(self, transition: Transition) -> None:  # noqa: D102
        self.replay.add(transition, self._scaled(transition.action))
        updates = self._count(transition.terminated or transition.truncated)
        if updates:
            with self._updating():
                self._train(updates)

    def state_values(self, observations: Observations) -> NDArray[np.float64]:
        """Return V(s) (n,) of `observations` (n, o), including the entropy bonus."""
        hyper, inputs = self.hyperparameters, as_batch(observations, self.device)
        total = torch.zeros((len(inputs), 1), dtype=torch.float64, device=self.device)
        with torch.no_grad():
            outputs = self._actor.networks[0].frozen(inputs)
            for noise in self.value_noise(len(inputs)):
                draw = squashed_draw(outputs, torch.from_numpy(noise).to(self.device), hyper.log_std)
                critics = joint_pass([critic.frozen for critic in self._critics.networks])
                total += soft_values(critics, inputs, draw, hyper.entropy_coefficient)
        values: NDArray[np.float64] = (total[:, 0] / hyper.value_samples).numpy(force=True)
        return values

    def value_noise(self, states: int) -> NDArray[np.float32]:
        """Return standard normal noise (m, n, a) for m sampled actions per state."""
        shape = self.hyperparameters.value_samples, states, self._low.size
        noise: NDArray[np.float32] = self._values.standard_normal(shape, dtype=np.float32)
        return noise

    def save_policy(self, folder: Path) -> None:
        """Write the actor's layers that compute the mean action.

        To act elsewhere, apply the layers with ReLUs between, and map the tanh of the result from [-1, 1] to
        the action space.
        """
        hyperparameters = {"hidden_units": list(self.hyperparameters.hidden_units)}
        spaces = self.observation_space, self.action_space
        write_policy(folder, POLICY, *spaces, self._acting.tensors(), hyperparameters)

    @classmethod
    def load_policy(cls, folder: Path, device: str = "cpu") -> Policy:  # noqa: D102
        stored = read_policy(folder, POLICY)
        stored.check(tensor_specs(stored))
        network = stored_network(stored, device)
        (size,) = stored.observation_space.shape
        bounds = stored.action_space.low, stored.action_space.high
        low, high = (np.asarray(bound, np.float32) for bound in bounds)

        def act(observations: Observations) -> Actions:
            check_rows(observations, size)
            return rescale(low, high, network(observations, squash=True))

        return act

    @classmethod
    def policy_layers(cls, folder: Path) -> nn.Sequential:  # noqa: D102
        stored = read_policy(folder, POLICY)
        stored.check(tensor_specs(stored))
        layers = as_modules(*stored_parameters(stored))
        return as_sequential([*layers, nn.Tanh(), unscale(stored.action_space)])

    def _save_experience(self, folder: Path, incremental: bool) -> tuple[dict[str, Any], tuple[str, ...]]:
        return self.experience(), self.replay.save(folder, incremental)

    def _load_experience(self, folder: Path, counters: dict[str, Any]) -> None:
        self.replay.load(folder)
        self.restore_experience(counters)


class StockSAC(SAC):
    """SAC that is updated by stable-baselines3's own `train`."""

    def _prepare_update(self) -> None:
        """Do nothing, since the model's own optimisers are used."""

    def _train(self, updates: int) -> None:
        self.model.train(gradient_steps=updates, batch_size=self.hyperparameters.batch_size)
