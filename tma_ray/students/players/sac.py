"""SAC's acting half. Imports no torch."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tma_ray.students.base import Actions, Observations, Transition
from tma_ray.students.hyperparameters import LogStd, SACHyperparameters
from tma_ray.students.mlp.layout import Layout
from tma_ray.students.players.base import Player
from tma_ray.students.players.link import Weights
from tma_ray.students.sac.acting import (
    LOG_STD_RANGE,
    between,
    sampled_actions,
    squashed_action,
    uniform_actions,
    updates_due,
)


class SACPlayer(Player):
    """Acts as `tma_ray.students.sac.student.SAC`, and hands over what it saw when updates are due."""

    algorithm_version = SACHyperparameters.algorithm_version
    hyperparameters_type = SACHyperparameters

    def _layout(self, observation: int, action: int) -> Layout:
        return Layout((observation, *self.hyperparameters.hidden_units, 2 * action))

    def _start(self) -> None:
        self._steps, self._episode_steps = 0, 0
        self._forget()

    def _take_over(self, weights: Weights) -> None:
        self._network.load(weights)

    def _forget(self) -> None:
        self._observations: list[Observations] = []
        self._actions: list[Actions] = []
        self._rewards: list[float] = []

    def act(self, observation: Observations) -> Actions:  # noqa: D102
        if self._steps < self.hyperparameters.exploration_steps:
            return self._exploration.uniform(self._low, self._high).astype(np.float32)
        network, clamp = self._network.row.arrays, self.hyperparameters.log_std is LogStd.CLAMP
        action = squashed_action(network, observation, self._noise(), LOG_STD_RANGE, clamp)
        return between(self._low, self._high, action)

    def observe(self, transition: Transition) -> None:  # noqa: D102
        if not self._observations:
            self._observations.append(transition.observation)
        self._observations.append(transition.next_observation)
        self._actions.append(transition.action)
        self._rewards.append(transition.reward)
        self._steps += 1
        self._episode_steps += 1
        ended = transition.terminated or transition.truncated
        updates = updates_due(self.hyperparameters, self._steps, self._episode_steps, ended)
        if ended:
            self._episode_steps = 0
        if ended or updates:
            self._hand_over(transition.terminated, updates)

    def act_greedily(self, observations: Observations) -> Actions:  # noqa: D102
        means = self._network(observations)[:, : self._low.size]
        return between(self._low, self._high, np.tanh(means))

    def sample_actions(self, observations: Observations, rng: np.random.Generator) -> Actions:  # noqa: D102
        bounds = self._low, self._high
        if self._steps < self.hyperparameters.exploration_steps:
            return uniform_actions(bounds, rng, len(observations))
        clamp = self.hyperparameters.log_std is LogStd.CLAMP
        return sampled_actions(self._network(observations), bounds, rng, clamp)

    def state_values(self, observations: Observations) -> NDArray[np.float64]:
        """Returns V(s) (n,) of `observations` (n, o), entropy bonus included."""
        return self._link.values(observations)

    def _hand_over(self, terminated: bool, updates: int) -> None:
        actions = np.array(self._actions, dtype=np.float32)
        scaled = 2 * ((actions - self._low) / (self._high - self._low)) - 1
        rewards = np.array(self._rewards, dtype=np.float32)
        observations = np.array(self._observations, dtype=np.float32)
        self._forget()
        weights = self._link.learn((observations, scaled, rewards, terminated), updates)
        if weights is not None:
            self._take_over(weights)

    def _experience(self) -> dict[str, Any]:
        return {"steps": self._steps}

    def _restore_experience(self, experience: dict[str, Any]) -> None:
        self._steps = experience["steps"]
        self._episode_steps = 0  # states are saved at the end of an episode, after its updates
