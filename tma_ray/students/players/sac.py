"""SAC's acting half. Imports no torch."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tma_ray.jit import kernel
from tma_ray.students.base import Actions, Observations, Transition
from tma_ray.students.hyperparameters import LogStd, SACHyperparameters, UpdateSchedule
from tma_ray.students.mlp.acting import FloatArray, RowArrays, apply_row
from tma_ray.students.mlp.layout import Layout
from tma_ray.students.players.base import Player
from tma_ray.students.players.link import Weights

LOG_STD_RANGE = -20.0, 2.0
"""Bounds of the log deviation."""

SQUASH_EPSILON = 1e-6
"""Keeps the logarithm of the squashing's derivative finite, as in stable-baselines3."""

NODES, NODE_WEIGHTS = np.polynomial.hermite_e.hermegauss(32)
"""Nodes and weights of Gauss-Hermite quadrature; the weights sum to sqrt(2 pi)."""


@kernel
def squashed_action(
    network: RowArrays,
    observation: Observations,
    noise: FloatArray,
    log_std_range: tuple[float, float],
    clamp: bool,
) -> Actions:
    """Return the tangent hyperbolic (a,) of a normal variable.

    Args:
        network: network whose outputs are means and unbounded log deviations.
        observation: values (o,).
        noise: standard normal (a,).
        log_std_range: bounds of the log deviation.
        clamp: True to clamp the log deviation to its range; else it is a scaled tangent hyperbolic.
    """
    weights, sizes, work, active, is_tanh = network
    low, high = np.float32(log_std_range[0]), np.float32(log_std_range[1])
    outputs = apply_row(weights, sizes, work, active, is_tanh, observation)
    count = len(noise)
    actions = np.empty_like(noise)
    for k in range(count):
        output = outputs[count + k]
        if clamp:
            log_deviation = min(max(output, low), high)
        else:
            log_deviation = low + np.float32(0.5) * (high - low) * (np.tanh(output) + np.float32(1))
        actions[k] = np.tanh(outputs[k] + np.exp(log_deviation) * noise[k])
    return actions


def sampled_actions(
    outputs: FloatArray, bounds: tuple[Actions, Actions], rng: np.random.Generator, clamp: bool
) -> Actions:
    """Return actions (n, a) drawn as `squashed_action` draws them, between `bounds`.

    Args:
        outputs: outputs of the network for n observations (n, 2a).
        bounds: lower and upper ones of the action space, (a,) each.
        rng: source of the noise.
        clamp: bounds of `squashed_action`.
    """
    means, log_deviations = normal_of(outputs, clamp)
    noise = rng.standard_normal(means.shape, dtype=np.float32)
    return between(*bounds, np.tanh(means + np.exp(log_deviations) * noise))


def normal_of(outputs: FloatArray, clamp: bool) -> tuple[FloatArray, FloatArray]:
    """Return means and log deviations (n, a) before squashing; arguments as of `sampled_actions`."""
    low, high = (np.float32(bound) for bound in LOG_STD_RANGE)
    means, spreads = np.split(outputs, 2, axis=1)
    half = np.float32(0.5) * (high - low)
    return means, np.clip(spreads, low, high) if clamp else low + half * (np.tanh(spreads) + 1)


def entropies(outputs: FloatArray, clamp: bool) -> NDArray[np.float64]:
    """Return the entropy (n,), in nats, of squashed actions; arguments as of `sampled_actions`."""
    means, log_deviations = normal_of(outputs.astype(np.float64), clamp)
    actions = np.tanh(means[..., None] + np.exp(log_deviations)[..., None] * NODES)
    squashing = np.log(1 - actions**2 + SQUASH_EPSILON) @ NODE_WEIGHTS / math.sqrt(2 * math.pi)
    normal = log_deviations + 0.5 * math.log(2 * math.pi * math.e)
    total: NDArray[np.float64] = (normal + squashing).sum(axis=1)
    return total


def uniform_actions(bounds: tuple[Actions, Actions], rng: np.random.Generator, count: int) -> Actions:
    """Return `count` uniform actions (count, a) between `bounds`, those of the initial exploration."""
    return rng.uniform(*bounds, size=(count, len(bounds[0]))).astype(np.float32)


def between(low: Actions, high: Actions, actions: Actions) -> Actions:
    """Return `actions` mapped from [-1, 1] to [low, high]."""
    return low + np.float32(0.5) * (actions + 1) * (high - low)


def updates_due(hyper: SACHyperparameters, steps: int, episode_steps: int, ended: bool) -> int:
    """Return the number of updates after a step.

    Args:
        hyper: hyper-parameters of the student.
        steps: steps of the run, this one included.
        episode_steps: steps of the episode, this one included.
        ended: an episode ended with the step.
    """
    if hyper.updates is UpdateSchedule.EPISODE_END:
        return math.ceil(episode_steps / hyper.steps_per_update) if ended else 0
    return int(steps > hyper.exploration_steps and steps % hyper.steps_per_update == 0)


class SACPlayer(Player):
    """Player of `tma_ray.students.sac.SAC`, which hands over its experience when updates are due."""

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
        """Return V(s) (n,) of `observations` (n, o), entropy bonus included."""
        return self._link.values(observations)

    def entropy_bonuses(self, observations: Observations) -> NDArray[np.float64]:  # noqa: D102
        clamp = self.hyperparameters.log_std is LogStd.CLAMP
        alpha: float = self.hyperparameters.entropy_coefficient
        return alpha * entropies(self._network(observations), clamp)

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
