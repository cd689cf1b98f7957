"""PPO's update with a hand-written backward pass: stable-baselines3's mathematics without its overhead."""

from __future__ import annotations

import math

import stable_baselines3
import torch
from stable_baselines3.common.type_aliases import RolloutBufferSamples
from stable_baselines3.common.utils import explained_variance

from tma_ray.students.flat_adam import FlatAdam
from tma_ray.students.hyperparameters import PPOHyperparameters
from tma_ray.students.perceptron import FlatParameters, blocks_of
from tma_ray.students.rollout import Rollout

_HALF_LOG_2PI = 0.5 * math.log(2 * math.pi)

Losses = tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]
"""Of the policy and of the value, approximate divergence from the old policy, share of clipped ratios."""


def gaussian_log_probability(error: torch.Tensor, log_std: torch.Tensor) -> torch.Tensor:
    """Returns the log density (n,) of actions that are `error` (n, a) deviations from the mean."""
    return -(0.5 * error.square() + (log_std + _HALF_LOG_2PI)).sum(dim=1)


class PPOUpdate:
    """Trains the networks of `model`, whose policy and value share a `Trunk`.

    The model stays their owner, and the owner of the optimiser's state.

    Args:
        model: a set-up stable-baselines3 PPO.
        hyperparameters: of the student.
    """

    def __init__(self, model: stable_baselines3.PPO, hyperparameters: PPOHyperparameters) -> None:
        policy = model.policy
        blocks = blocks_of(policy.features_extractor, policy.action_net, policy.value_net)
        self._flat = FlatParameters([blocks], others=[policy.log_std])
        self._network = self._flat.networks[0]
        self._log_std = policy.log_std.detach()
        self._log_std_gradient = self._flat.gradient[-len(self._log_std) :]
        self._adam = FlatAdam(policy.optimizer, self._flat)
        self._model, self._hyper = model, hyperparameters

    def restore(self) -> None:
        """Takes over the optimiser's state after the model was loaded."""
        self._adam.restore()

    def __call__(self, rollout: Rollout) -> None:
        """Passes several times over the finished `rollout`."""
        hyper, model = self._hyper, self._model
        with torch.no_grad():
            losses = [
                self.train_on(batch) for _ in range(hyper.epochs) for batch in rollout.get(hyper.batch_size)
            ]
        model._n_updates += hyper.epochs
        names = ("policy_gradient_loss", "value_loss", "approx_kl", "clip_fraction")
        for name, values in zip(names, zip(*losses, strict=True), strict=True):
            model.logger.record(f"train/{name}", torch.stack(values).mean().item())
        model.logger.record("train/std", self._log_std.exp().mean().item())
        variance = explained_variance(rollout.values, rollout.returns)
        model.logger.record("train/explained_variance", variance)

    def train_on(self, batch: RolloutBufferSamples) -> Losses:
        """Takes one optimiser step on the mini-batch `batch`, under `torch.no_grad`; returns losses."""
        hyper = self._hyper
        outputs = self._network.forward(batch.observations)
        gradient = torch.empty_like(outputs)
        policy_losses = self._policy_gradient(batch, outputs[:, :-1], gradient[:, :-1])
        value_loss = self._value_gradient(batch, outputs[:, -1], gradient[:, -1])
        self._network.backward(gradient)
        norm = torch.linalg.vector_norm(self._flat.gradient)
        self._flat.gradient.mul_(torch.clamp(hyper.max_gradient_norm / (norm + 1e-6), max=1.0))
        self._adam.step()
        policy_loss, divergence, clipped = policy_losses
        return policy_loss, value_loss, divergence, clipped

    def _policy_gradient(
        self, batch: RolloutBufferSamples, mean: torch.Tensor, gradient: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Writes the gradients of `mean` (n, a) and of the log deviation."""
        clip = self._hyper.clip_range
        advantages = batch.advantages
        advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
        error = (batch.actions - mean) / self._log_std.exp()  # in deviations
        log_ratio = gaussian_log_probability(error, self._log_std) - batch.old_log_prob
        ratio = log_ratio.exp()
        free, bounded = advantages * ratio, advantages * ratio.clamp(1 - clip, 1 + clip)
        # the smaller of the two counts; where that is the bounded one, and bound, nothing flows back
        share = (free * (free <= bounded)).div_(-len(ratio))[:, None]
        torch.mul(share, error / self._log_std.exp(), out=gradient)
        torch.sum(share * (error.square() - 1), dim=0, out=self._log_std_gradient)
        self._log_std_gradient.sub_(self._hyper.entropy_coefficient)
        divergence = (ratio - 1 - log_ratio).mean()
        clipped = ((ratio - 1).abs() > clip).float().mean()
        return -torch.minimum(free, bounded).mean(), divergence, clipped

    def _value_gradient(
        self, batch: RolloutBufferSamples, value: torch.Tensor, gradient: torch.Tensor
    ) -> torch.Tensor:
        """Writes the gradient of `value` (n,); returns its loss."""
        clip, predicted = self._hyper.value_clip_range, value
        if clip is not None:
            change = value - batch.old_values
            predicted = batch.old_values + change.clamp(-clip, clip)
        error = predicted - batch.returns
        torch.mul(error, 2 * self._hyper.value_coefficient / len(error), out=gradient)
        if clip is not None:
            gradient.mul_(change.abs() <= clip)
        return error.square().mean()
