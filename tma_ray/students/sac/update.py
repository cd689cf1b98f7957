"""SAC's update with a hand-written backward pass: stable-baselines3's mathematics without its overhead."""

from __future__ import annotations

import math
from typing import NamedTuple

import stable_baselines3
import torch
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from stable_baselines3.sac.policies import LOG_STD_MAX, LOG_STD_MIN

from tma_ray.students.flat_adam import FlatAdam
from tma_ray.students.hyperparameters import SACHyperparameters
from tma_ray.students.perceptron import FlatParameters, Perceptron, blocks_of

SQUASH_EPSILON = 1e-6
"""Keeps the logarithm of the squashing's derivative finite, as in stable-baselines3."""

_HALF_LOG_2PI = 0.5 * math.log(2 * math.pi)


class Sample(NamedTuple):
    """Actions drawn from the policy, and what their backward pass needs.

    Attributes:
        actions: squashed to [-1, 1] (n, a).
        log_probabilities: of the actions (n,).
        outputs: of the actor: means and log deviations, not clamped (n, 2a).
        spread: deviations times noise (n, a).
        derivative: of the squashing, 1 - actions² (n, a).
    """

    actions: torch.Tensor
    log_probabilities: torch.Tensor
    outputs: torch.Tensor
    spread: torch.Tensor
    derivative: torch.Tensor


class SACUpdate:
    """Trains the networks of `model`, which stays their owner, and the owner of the optimisers' states.

    The gradient of the actor's loss passes each critic only where it is the smaller one, and gives the
    critics' parameters none.

    Args:
        model: a set-up stable-baselines3 SAC with a fixed entropy coefficient.
        hyperparameters: of the student.
    """

    def __init__(self, model: stable_baselines3.SAC, hyperparameters: SACHyperparameters) -> None:
        actor, critic, target = model.actor, model.critic, model.critic_target
        heads = actor.mu, actor.log_std
        self._actor_parameters = FlatParameters([blocks_of(actor.latent_pi, *heads)])  # type: ignore[arg-type]
        self._critic_parameters = FlatParameters([blocks_of(network) for network in critic.q_networks])
        self._target_parameters = FlatParameters([blocks_of(network) for network in target.q_networks])
        (self._actor,) = self._actor_parameters.networks
        self._critics, self._targets = self._critic_parameters.networks, self._target_parameters.networks
        self._actor_adam = FlatAdam(actor.optimizer, self._actor_parameters)
        self._critic_adam = FlatAdam(critic.optimizer, self._critic_parameters)
        self._model, self._hyper = model, hyperparameters

    def restore(self) -> None:
        """Takes over the optimisers' states after the model was loaded."""
        self._actor_adam.restore()
        self._critic_adam.restore()

    def __call__(self, batch: ReplayBufferSamples) -> None:
        """Takes one step of the critics, of the actor and of the targets; draws from torch's generator."""
        with torch.no_grad():
            noise, next_noise = (torch.randn_like(batch.actions) for _ in range(2))
            targets = self._target_values(batch, next_noise)
            critic_loss = self._train_critics(batch, targets)
            actor_loss = self._train_actor(batch.observations, noise)
            self._target_parameters.values.lerp_(self._critic_parameters.values, self._hyper.target_rate)
        self._model._n_updates += 1
        self._model.logger.record("train/critic_loss", critic_loss.item())
        self._model.logger.record("train/actor_loss", actor_loss.item())

    def _target_values(self, batch: ReplayBufferSamples, noise: torch.Tensor) -> torch.Tensor:
        """Returns r + gamma (min Q - alpha log pi) of the next states (n, 1)."""
        hyper = self._hyper
        sample = self._sample(batch.next_observations, noise)
        q = _values(self._targets, batch.next_observations, sample.actions).amin(dim=1, keepdim=True)
        soft = q - hyper.entropy_coefficient * sample.log_probabilities[:, None]
        return batch.rewards + (1 - batch.dones) * hyper.gamma * soft

    def _train_critics(self, batch: ReplayBufferSamples, targets: torch.Tensor) -> torch.Tensor:
        error = _values(self._critics, batch.observations, batch.actions) - targets
        for critic, gradient in zip(self._critics, (error / len(error)).unbind(dim=1), strict=True):
            critic.backward(gradient[:, None])
        self._critic_adam.step()
        return 0.5 * error.square().mean(dim=0).sum()

    def _train_actor(self, observations: torch.Tensor, noise: torch.Tensor) -> torch.Tensor:
        sample = self._sample(observations, noise)
        actions, derivative = sample.actions, sample.derivative
        q, smaller = _values(self._critics, observations, actions).min(dim=1)
        alpha, count = self._hyper.entropy_coefficient, len(actions)
        gradient = 2 * alpha / count * actions / (derivative + SQUASH_EPSILON)
        for index, critic in enumerate(self._critics):
            rows = (smaller == index).nonzero()[:, 0]
            outer = gradient.new_full((len(rows), 1), -1 / count)
            gradient[rows] += critic.input_gradient(outer, rows)[:, -actions.shape[1] :]
        gradient *= derivative
        log_gradient = gradient * sample.spread - alpha / count
        log_deviations = sample.outputs[:, actions.shape[1] :]
        log_gradient *= (log_deviations >= LOG_STD_MIN) & (log_deviations <= LOG_STD_MAX)
        self._actor.backward(torch.cat((gradient, log_gradient), dim=1))
        self._actor_adam.step()
        return (alpha * sample.log_probabilities - q).mean()

    def _sample(self, observations: torch.Tensor, noise: torch.Tensor) -> Sample:
        outputs = self._actor.forward(observations)
        mean, log_deviation = outputs.chunk(2, dim=1)
        log_deviation = log_deviation.clamp(LOG_STD_MIN, LOG_STD_MAX)
        spread = log_deviation.exp() * noise
        actions = (mean + spread).tanh()
        derivative = 1 - actions.square()
        log_density = -0.5 * noise.square() - log_deviation - _HALF_LOG_2PI
        log_probabilities = (log_density - (derivative + SQUASH_EPSILON).log()).sum(dim=1)
        return Sample(actions, log_probabilities, outputs, spread, derivative)


def _values(critics: list[Perceptron], observations: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
    """Returns every critic's values (n, c)."""
    inputs = torch.cat((observations, actions), dim=1)
    return torch.cat([critic.forward(inputs) for critic in critics], dim=1)
