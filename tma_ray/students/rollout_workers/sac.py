"""Action selection and rollout worker of SAC, importable without torch."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tma_ray.students.base import Actions, Observations, Transition
from tma_ray.students.hyperparameters import LogStd, SACHyperparameters, UpdateSchedule
from tma_ray.students.mlp.acting import FloatArray, RowArrays, apply_row
from tma_ray.students.rollout_workers.base import ActingStudent, RolloutWorker
from tma_ray.students.rollout_workers.link import Weights
from tma_ray.support.jit import kernel

LOG_STD_RANGE = -20.0, 2.0  # bounds of the log standard deviation
SQUASH_EPSILON = 1e-6  # avoids log(0) in the density of squashed actions, as in stable-baselines3

NODES, NODE_WEIGHTS = np.polynomial.hermite_e.hermegauss(32)
"""Nodes and weights of Gauss-Hermite quadrature, whose weights sum to sqrt(2 pi)."""


@kernel
def squashed_action(
    network: RowArrays,
    observation: Observations,
    noise: FloatArray,
    log_std_range: tuple[float, float],
    clamp: bool,
) -> Actions:
    """Return an action (a,) sampled from the tanh-squashed normal policy.

    Args:
        network: network of means and unbounded log standard deviations.
        observation: observation (o,).
        noise: standard normal noise (a,).
        log_std_range: bounds of the log standard deviation.
        clamp: True to clamp the log standard deviation to its range, False for a scaled tanh.
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
    """Sample actions (n, a) within `bounds` (a,) from the policy with `outputs` (n, 2a)."""
    means, log_deviations = normal_parameters(outputs, clamp)
    noise = rng.standard_normal(means.shape, dtype=np.float32)
    return rescale(*bounds, np.tanh(means + np.exp(log_deviations) * noise))


def normal_parameters(outputs: FloatArray, clamp: bool) -> tuple[FloatArray, FloatArray]:
    """Return means and log standard deviations (n, a) of the actions before squashing."""
    low, high = (np.float32(bound) for bound in LOG_STD_RANGE)
    means, spreads = np.split(outputs, 2, axis=1)
    half = np.float32(0.5) * (high - low)
    return means, np.clip(spreads, low, high) if clamp else low + half * (np.tanh(spreads) + 1)


def entropies(outputs: FloatArray, clamp: bool) -> NDArray[np.float64]:
    """Return the entropy (n,) of the squashed actions, in nats."""
    means, log_deviations = normal_parameters(outputs.astype(np.float64), clamp)
    actions = np.tanh(means[..., None] + np.exp(log_deviations)[..., None] * NODES)
    squashing = np.log(1 - actions**2 + SQUASH_EPSILON) @ NODE_WEIGHTS / math.sqrt(2 * math.pi)
    normal = log_deviations + 0.5 * math.log(2 * math.pi * math.e)
    total: NDArray[np.float64] = (normal + squashing).sum(axis=1)
    return total


def rescale(low: Actions, high: Actions, actions: Actions) -> Actions:
    """Return `actions` mapped from [-1, 1] to [low, high]."""
    return low + np.float32(0.5) * (actions + 1) * (high - low)


class SACActing(ActingStudent):
    """Base class of SAC and its rollout worker, which draw actions uniformly at first, then by the policy."""

    algorithm_version = SACHyperparameters.algorithm_version
    hyperparameters_type = SACHyperparameters
    hyperparameters: SACHyperparameters

    def _start(self) -> None:
        self._steps, self._episode_steps = 0, 0

    def act(self, observation: Observations) -> Actions:  # noqa: D102
        if self._steps < self.hyperparameters.exploration_steps:
            return self._exploration.uniform(self._low, self._high).astype(np.float32)
        network, clamp = self._acting.row.arrays, self.hyperparameters.log_std is LogStd.CLAMP
        action = squashed_action(network, observation, self._noise(), LOG_STD_RANGE, clamp)
        return rescale(self._low, self._high, action)

    def act_greedily(self, observations: Observations) -> Actions:  # noqa: D102
        return rescale(self._low, self._high, self._acting(observations, squash=True))

    def sample_actions(self, observations: Observations, rng: np.random.Generator) -> Actions:  # noqa: D102
        bounds = self._low, self._high
        if self._steps < self.hyperparameters.exploration_steps:
            return rng.uniform(*bounds, size=(len(observations), self._low.size)).astype(np.float32)
        clamp = self.hyperparameters.log_std is LogStd.CLAMP
        return sampled_actions(self._acting.outputs(observations), bounds, rng, clamp)

    def entropy_bonuses(self, observations: Observations) -> NDArray[np.float64]:  # noqa: D102
        clamp = self.hyperparameters.log_std is LogStd.CLAMP
        return self.hyperparameters.entropy_coefficient * entropies(self._acting.outputs(observations), clamp)

    def _count(self, ended: bool) -> int:
        """Count a step, and return the number of updates due after it."""
        hyper = self.hyperparameters
        self._steps += 1
        self._episode_steps += 1
        length = self._episode_steps
        if ended:
            self._episode_steps = 0
        if hyper.updates is UpdateSchedule.EPISODE_END:
            return math.ceil(length / hyper.steps_per_update) if ended else 0
        return int(self._steps > hyper.exploration_steps and self._steps % hyper.steps_per_update == 0)

    def _scaled(self, actions: Actions) -> Actions:
        """Return `actions` mapped from the action space to [-1, 1]."""
        return 2 * ((actions - self._low) / (self._high - self._low)) - 1

    def experience(self) -> dict[str, Any]:
        """Return the number of steps, to be saved."""
        return {"steps": self._steps}

    def restore_experience(self, experience: dict[str, Any]) -> None:
        """Restore values that `experience` returned at the end of an episode."""
        self._steps, self._episode_steps = experience["steps"], 0


class SACRolloutWorker(SACActing, RolloutWorker):
    """Rollout worker of `tma_ray.students.sac.SAC` that sends experience when updates are due."""

    def _start(self) -> None:
        super()._start()
        self._forget()

    def _load_weights(self, weights: Weights) -> None:
        self._acting.load(weights)

    def _forget(self) -> None:
        self._observations: list[Observations] = []
        self._actions: list[Actions] = []
        self._rewards: list[float] = []

    def observe(self, transition: Transition) -> None:  # noqa: D102
        if not self._observations:
            self._observations.append(transition.observation)
        self._observations.append(transition.next_observation)
        self._actions.append(transition.action)
        self._rewards.append(transition.reward)
        ended = transition.terminated or transition.truncated
        updates = self._count(ended)
        if ended or updates:
            columns = self._observations, self._actions, self._rewards
            observations, actions, rewards = (np.array(column, dtype=np.float32) for column in columns)
            self._forget()
            experience = observations, self._scaled(actions), rewards, transition.terminated
            weights = self._link.learn(experience, updates)
            if weights is not None:
                self._load_weights(weights)

    def state_values(self, observations: Observations) -> NDArray[np.float64]:
        """Return V(s) (n,) of `observations` (n, o), including the entropy bonus."""
        values: NDArray[np.float64] = self._link.ask("values", observations)
        return values
