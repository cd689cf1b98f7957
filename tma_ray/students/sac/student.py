"""SAC over stable-baselines3, with the paper's hyper-parameters."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import stable_baselines3
import torch
from numpy.typing import NDArray
from stable_baselines3.sac.policies import LOG_STD_MAX, LOG_STD_MIN
from torch import nn

from tma_ray.students.base import Actions, Observations, Policy, Transition
from tma_ray.students.hyperparameters import SACHyperparameters
from tma_ray.students.layers import in_a_row, unscale, with_relus
from tma_ray.students.mean_network import (
    check_rows,
    layer_kinds,
    layer_tensors,
    stored_layers,
    stored_network,
)
from tma_ray.students.mirror import Mirror
from tma_ray.students.networks import Pass, as_batch
from tma_ray.students.perceptron import blocks_of
from tma_ray.students.policy_files import read_policy
from tma_ray.students.replay import ReplayBuffer
from tma_ray.students.sac.update import SQUASH_EPSILON, SACUpdate
from tma_ray.students.sb3.stable_baselines import Experience, StableBaselinesStudent

POLICY = "sac"
"""What saved policies say that they are; those of `StockSAC` say the same."""


class SAC(StableBaselinesStudent[SACHyperparameters, stable_baselines3.SAC]):
    """Soft actor-critic with a fixed entropy coefficient: one update every 10 steps.

    The first 10,000 actions of the run are uniform, without updates. Time limits bootstrap. The greedy
    action is the squashed mean. stable-baselines3 has no V network (the original release has one):
    V(s) = E[min Q(s, a) - alpha log pi(a|s)] is averaged over sampled actions.
    """

    algorithm_version = SACHyperparameters.algorithm_version
    hyperparameters_type = SACHyperparameters

    def _make_model(self) -> stable_baselines3.SAC:
        hyper = self.hyperparameters
        model = stable_baselines3.SAC(
            "MlpPolicy",
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
            target_entropy=0.0,  # only a learned coefficient has a target
            policy_kwargs={"net_arch": list(hyper.hidden_units), "activation_fn": nn.ReLU},
            device=self.device,
            _init_setup_model=False,
        )
        model.replay_buffer = self._replay  # type: ignore[assignment]
        return model

    def _start(self) -> None:
        sizes = self.observation_space.shape[0], self.action_space.shape[0]
        self._replay = ReplayBuffer(self.hyperparameters.buffer_size, *sizes, self._batches, self.device)
        self._steps = 0

    def _connect(self) -> None:
        actor = self.model.actor
        self._replay.clear()
        self._prepare_update()
        self._hidden = Pass(actor.latent_pi, relu=True)
        self._mean_head = Pass(actor.mu, relu=False)
        self._log_std_head = Pass(actor.log_std, relu=False)  # type: ignore[arg-type]
        self._mirror = Mirror(blocks_of(actor.latent_pi, actor.mu, actor.log_std))  # type: ignore[arg-type]

    def _refresh(self) -> None:
        self._mirror.refresh()

    def _prepare_update(self) -> None:
        """Makes what `_train` needs for `self.model`, before anything else shares its parameters."""
        self._update = SACUpdate(self.model, self.hyperparameters)

    def _restore_update(self) -> None:
        self._update.restore()

    def _train(self) -> None:
        """Updates the networks once."""
        self._update(self._replay.sample(self.hyperparameters.batch_size))

    def act(self, observation: Observations) -> Actions:  # noqa: D102
        if self._steps < self.hyperparameters.exploration_steps:
            return self._exploration.uniform(self._low, self._high).astype(np.float32)
        squashed = self._mirror.sample_squashed(observation, self._noise(), (LOG_STD_MIN, LOG_STD_MAX))
        return self._unscale(squashed)

    def observe(self, transition: Transition) -> None:  # noqa: D102
        self._replay.add(transition, self._scale(transition.action))
        self._steps += 1
        hyper = self.hyperparameters
        if self._steps > hyper.exploration_steps and self._steps % hyper.steps_per_update == 0:
            with self._updating():
                self._train()

    def act_greedily(self, observations: Observations) -> Actions:  # noqa: D102
        if len(observations) == 1:
            mean = self._mirror(observations[0])[: self._low.size]
            return self._unscale(np.tanh(mean)[None])
        hidden = self._hidden(as_batch(observations, self.device))
        return self._unscale(self._mean_head(hidden).tanh_().numpy(force=True))

    def state_values(self, observations: Observations) -> NDArray[np.float64]:
        """Returns V(s) (n,) of `observations` (n, o), entropy bonus included."""
        inputs = as_batch(observations, self.device)
        hidden = self._hidden(inputs)
        mean, std = self._mean_head(hidden), self._std(hidden)
        total = torch.zeros(len(inputs), dtype=torch.float64, device=self.device)
        with torch.inference_mode():
            for _ in range(self.hyperparameters.value_samples):
                draw = self._values.standard_normal(tuple(mean.shape), dtype=np.float32)
                noise = torch.from_numpy(draw).to(self.device)
                total += self._soft_values(inputs, mean, std, noise)
        values: NDArray[np.float64] = (total / self.hyperparameters.value_samples).numpy(force=True)
        return values

    def save_policy(self, folder: Path) -> None:
        """Writes the actor's layers to the mean.

        To play elsewhere: the layers with ReLUs between, and the tangent hyperbolic of the result mapped from
        [-1, 1] to the action space.
        """
        actor = self.model.actor
        hyperparameters = {"hidden_units": list(self.hyperparameters.hidden_units)}
        self._write_policy(folder, POLICY, layer_tensors(actor.latent_pi, actor.mu), hyperparameters)

    @classmethod
    def load_policy(cls, folder: Path, device: str = "cpu") -> Policy:  # noqa: D102
        stored = read_policy(folder, POLICY)
        stored.check(layer_kinds(stored))
        means = stored_network(stored, squash=True, device=device)
        (size,) = stored.observation_space.shape
        bounds = stored.action_space.low, stored.action_space.high
        low, high = (np.asarray(bound, np.float32) for bound in bounds)

        def act(observations: Observations) -> Actions:
            check_rows(observations, size)
            return _between(low, high, means(observations))

        return act

    @classmethod
    def policy_layers(cls, folder: Path) -> nn.Sequential:  # noqa: D102
        stored = read_policy(folder, POLICY)
        stored.check(layer_kinds(stored))
        layers = with_relus(stored_layers(stored, "cpu"))
        return in_a_row([*layers, nn.Tanh(), unscale(stored.action_space)])

    def _save_experience(self, folder: Path, incremental: bool) -> Experience:
        return Experience({"steps": self._steps}, self._replay.save(folder, incremental))

    def _load_experience(self, folder: Path, counters: dict[str, Any]) -> None:
        self._replay.load(folder)
        self._steps = counters["steps"]

    def _std(self, hidden: torch.Tensor) -> torch.Tensor:
        std: torch.Tensor = self._log_std_head(hidden).clamp_(LOG_STD_MIN, LOG_STD_MAX).exp_()
        return std

    def _soft_values(
        self, inputs: torch.Tensor, mean: torch.Tensor, std: torch.Tensor, noise: torch.Tensor
    ) -> torch.Tensor:
        """Returns min Q - alpha log pi (n,) of one action per state."""
        actions = torch.addcmul(mean, std, noise).tanh_()
        log_density = -0.5 * noise.square() - std.log() - 0.5 * math.log(2 * math.pi)
        log_probability = log_density - torch.log(1 - actions.square() + SQUASH_EPSILON)
        q = torch.cat(self.model.critic(inputs, actions), dim=1).min(dim=1).values
        return q - self.hyperparameters.entropy_coefficient * log_probability.sum(dim=1)

    def _scale(self, actions: Actions) -> Actions:
        """Returns `actions` mapped from the action space to [-1, 1]."""
        return 2 * ((actions - self._low) / (self._high - self._low)) - 1

    def _unscale(self, actions: Actions) -> Actions:
        """Returns `actions` mapped from [-1, 1] to the action space."""
        return _between(self._low, self._high, actions)


class StockSAC(SAC):
    """SAC whose update is stable-baselines3's own `train`; all else is alike."""

    def _prepare_update(self) -> None:
        """Prepares nothing."""

    def _restore_update(self) -> None:
        """Restores nothing: the model's optimisers are the only ones."""

    def _train(self) -> None:
        self.model.train(gradient_steps=1, batch_size=self.hyperparameters.batch_size)


def _between(low: Actions, high: Actions, actions: Actions) -> Actions:
    """Returns `actions` mapped from [-1, 1] to [low, high]."""
    return low + np.float32(0.5) * (actions + 1) * (high - low)
