"""PPO's exploring action in one compiled call: normalisation, networks, noise and clipping."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import stable_baselines3
from numpy.typing import NDArray

from tma_ray.jit import kernel
from tma_ray.students.base import Actions, Observations
from tma_ray.students.mirror import FloatArray, IntArray, Mirror, apply
from tma_ray.students.normaliser import Normaliser, scaled
from tma_ray.students.perceptron import blocks_of

Floats = NDArray[np.float64]


class Step(NamedTuple):
    """An exploring action and all that learning from it needs.

    Attributes:
        observation: normalised (o,).
        sampled: the action as sampled (a,).
        action: the same, inside the action space (a,).
        judged: value of the observation in normalised reward, log probability of `sampled`.
    """

    observation: Observations
    sampled: Actions
    action: Actions
    judged: tuple[float, float]


class Actor:
    """Mirrors the networks of `model`, whose policy and value share a `Trunk`.

    Args:
        model: a set-up stable-baselines3 PPO.
        bounds: of the action space (2, a).
    """

    def __init__(self, model: stable_baselines3.PPO, bounds: FloatArray) -> None:
        self._policy = model.policy
        policy = model.policy
        self._mirror = Mirror(blocks_of(policy.features_extractor, policy.action_net, policy.value_net))
        self._bounds = bounds
        self.refresh()

    def refresh(self) -> None:
        """Takes over the networks' present parameters."""
        self._mirror.refresh()
        self._log_deviation: FloatArray = self._policy.log_std.numpy(force=True).copy()

    def act(self, observation: Observations, normaliser: Normaliser, noise: FloatArray) -> Step:
        """Returns the action for `observation` (o,) under standard normal `noise` (a,)."""
        policy = self._log_deviation, self._bounds
        return Step(*_act(self._mirror.arrays, policy, normaliser.statistics, observation, noise))

    def greedy(self, observation: Observations) -> Actions:
        """Returns the mean (a,) for a normalised `observation` (o,)."""
        return self._mirror(observation)[:-1]


@kernel
def _act(
    network: tuple[FloatArray, IntArray, FloatArray, IntArray],
    policy: tuple[FloatArray, FloatArray],
    statistics: tuple[Floats, Floats, float],
    observation: Observations,
    noise: FloatArray,
) -> tuple[Observations, Actions, Actions, tuple[float, float]]:
    weights, sizes, work, active = network
    log_deviation, bounds = policy
    mean, variance, clip = statistics
    normalised = scaled(observation.reshape(1, -1), mean, variance, clip)[0]
    outputs = apply(weights, sizes, work, active, normalised)
    sampled, action = np.empty_like(noise), np.empty_like(noise)
    log_probability = 0.0
    for k in range(len(noise)):
        sampled[k] = outputs[k] + np.exp(log_deviation[k]) * noise[k]
        action[k] = min(max(sampled[k], bounds[0, k]), bounds[1, k])
        log_probability -= 0.5 * noise[k] * noise[k] + log_deviation[k] + 0.5 * math.log(2 * math.pi)
    return normalised, sampled, action, (outputs[len(noise)], log_probability)
