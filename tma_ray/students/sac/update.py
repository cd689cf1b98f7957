"""SAC's update of one run: stable-baselines3's mathematics without its overhead."""

from __future__ import annotations

import stable_baselines3
import torch
from stable_baselines3.common.type_aliases import ReplayBufferSamples

from tma_ray.students.hyperparameters import SACHyperparameters
from tma_ray.students.mlp.adam import FlatAdam
from tma_ray.students.mlp.modules import FlatParameters, blocks_of
from tma_ray.students.sac.losses import (
    Transitions,
    actor_loss,
    critic_loss,
    joined,
    soft_values,
    squashed_draw,
)


class SACUpdate:
    """Trains the networks of `model`, which stays their owner, and the owner of the optimisers' states.

    Args:
        model: a set-up stable-baselines3 SAC with a fixed entropy coefficient.
        actor: the parameters of its actor.
        critics: the parameters of its critics.
        hyperparameters: of the student.

    Attributes:
        actor: as given.
        critics: as given.
        targets: the parameters of the target critics.
        actor_adam: optimiser of the actor.
        critic_adam: optimiser of the critics.
    """

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

    def restore(self) -> None:
        """Takes over the optimisers' states after the model was loaded."""
        self.actor_adam.restore()
        self.critic_adam.restore()

    def __call__(self, samples: ReplayBufferSamples) -> None:
        """Takes one step of the critics, of the actor and of the targets; draws from torch's generator."""
        batch = Transitions(*samples[:5])
        noise, next_noise = (torch.randn_like(batch.actions) for _ in range(2))
        critics = self._train_critics(batch, next_noise)
        actor = self._train_actor(batch.observations, noise)
        self.targets.values.lerp_(self.critics.values, self._hyper.target_rate)
        self._model._n_updates += 1
        self._model.logger.record("train/critic_loss", critics.item())
        self._model.logger.record("train/actor_loss", actor.item())

    def _train_critics(self, batch: Transitions, noise: torch.Tensor) -> torch.Tensor:
        hyper, (actor,) = self._hyper, self.actor.networks
        with torch.no_grad():
            draw = squashed_draw(actor(batch.next_observations), noise, hyper.log_std)
            targets = joined([network.frozen for network in self.targets.networks])
            values = soft_values(targets, batch.next_observations, draw, hyper.entropy_coefficient)
            goals = batch.rewards + (1 - batch.dones) * hyper.gamma * values
        loss = critic_loss(joined(self.critics.networks), batch, goals)
        self.critics.differentiate(loss)
        self.critic_adam.step()
        return loss

    def _train_actor(self, observations: torch.Tensor, noise: torch.Tensor) -> torch.Tensor:
        hyper, (actor,) = self._hyper, self.actor.networks
        critics = joined([network.frozen for network in self.critics.networks])
        draw = squashed_draw(actor(observations), noise, hyper.log_std)
        loss = actor_loss(critics, observations, draw, hyper.entropy_coefficient)
        self.actor.differentiate(loss)
        self.actor_adam.step()
        return loss
