"""PPO's exploring action in one compiled call: normalisation, network, noise, clipping. Imports no torch."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tma_ray.jit import kernel
from tma_ray.students.base import Actions, Observations
from tma_ray.students.mlp.rows import FloatArray, RowArrays, apply_row
from tma_ray.students.normaliser import Normaliser, scaled

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


def exploring_step(
    network: RowArrays,
    policy: tuple[FloatArray, FloatArray],
    normaliser: Normaliser,
    observation: Observations,
    noise: FloatArray,
) -> Step:
    """Returns the action for an observation, and what learning from it needs.

    Args:
        network: whose outputs are means and value.
        policy: log deviation of the actions (a,), bounds of the action space (2, a).
        normaliser: of observations.
        observation: not normalised (o,).
        noise: standard normal (a,).
    """
    return Step(*_act(network, policy, normaliser.statistics, observation, noise))


def sampled_actions(
    means: FloatArray, policy: tuple[FloatArray, FloatArray], rng: np.random.Generator
) -> Actions:
    """Returns actions (n, a) drawn around `means` (n, a) with noise of `rng`; `policy` as above."""
    log_deviation, (low, high) = policy
    sampled = means + np.exp(log_deviation) * rng.standard_normal(means.shape, dtype=np.float32)
    actions: Actions = np.minimum(np.maximum(sampled, low), high)
    return actions


@kernel
def _act(
    network: RowArrays,
    policy: tuple[FloatArray, FloatArray],
    statistics: tuple[Floats, Floats, float],
    observation: Observations,
    noise: FloatArray,
) -> tuple[Observations, Actions, Actions, tuple[float, float]]:
    weights, sizes, work, active, is_tanh = network
    log_deviation, bounds = policy
    mean, variance, clip = statistics
    normalised = scaled(observation.reshape(1, -1), mean, variance, clip)[0]
    outputs = apply_row(weights, sizes, work, active, is_tanh, normalised)
    sampled, action = np.empty_like(noise), np.empty_like(noise)
    log_probability = 0.0
    for k in range(len(noise)):
        sampled[k] = outputs[k] + np.exp(log_deviation[k]) * noise[k]
        action[k] = min(max(sampled[k], bounds[0, k]), bounds[1, k])
        log_probability -= 0.5 * noise[k] * noise[k] + log_deviation[k] + 0.5 * math.log(2 * math.pi)
    return normalised, sampled, action, (outputs[len(noise)], log_probability)
