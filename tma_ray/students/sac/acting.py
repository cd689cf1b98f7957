"""SAC's exploring action in one compiled call: network, noise and squashing. Imports no torch."""

from __future__ import annotations

import math

import numpy as np

from tma_ray.jit import kernel
from tma_ray.students.base import Actions, Observations
from tma_ray.students.hyperparameters import SACHyperparameters, UpdateSchedule
from tma_ray.students.mlp.rows import FloatArray, RowArrays, apply_row

LOG_STD_RANGE = -20.0, 2.0
"""Bounds of the log deviation."""


@kernel
def squashed_action(
    network: RowArrays,
    observation: Observations,
    noise: FloatArray,
    log_std_range: tuple[float, float],
    clamp: bool,
) -> Actions:
    """Returns the tangent hyperbolic (a,) of a normal variable.

    Args:
        network: whose outputs are means and, before they are brought into their range, log deviations.
        observation: (o,).
        noise: standard normal (a,).
        log_std_range: bounds of the log deviation.
        clamp: the log deviation is clamped to its range; else it is a scaled tangent hyperbolic.
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
    """Returns actions (n, a) drawn as `squashed_action` draws them, between `bounds`.

    Args:
        outputs: of the network for n observations (n, 2a).
        bounds: lower and upper ones of the action space, (a,) each.
        rng: draws the noise.
        clamp: as for `squashed_action`.
    """
    low, high = (np.float32(bound) for bound in LOG_STD_RANGE)
    means, spreads = np.split(outputs, 2, axis=1)
    half = np.float32(0.5) * (high - low)
    log_deviations = np.clip(spreads, low, high) if clamp else low + half * (np.tanh(spreads) + 1)
    noise = rng.standard_normal(means.shape, dtype=np.float32)
    return between(*bounds, np.tanh(means + np.exp(log_deviations) * noise))


def uniform_actions(bounds: tuple[Actions, Actions], rng: np.random.Generator, count: int) -> Actions:
    """Returns `count` uniform actions (count, a) between `bounds`, those of the initial exploration."""
    return rng.uniform(*bounds, size=(count, len(bounds[0]))).astype(np.float32)


def between(low: Actions, high: Actions, actions: Actions) -> Actions:
    """Returns `actions` mapped from [-1, 1] to [low, high]."""
    return low + np.float32(0.5) * (actions + 1) * (high - low)


def updates_due(hyper: SACHyperparameters, steps: int, episode_steps: int, ended: bool) -> int:
    """Returns how many updates follow a step.

    Args:
        hyper: hyper-parameters of the student.
        steps: of the run, this one included.
        episode_steps: of the episode, likewise.
        ended: an episode ended with the step.
    """
    if hyper.updates is UpdateSchedule.EPISODE_END:
        return math.ceil(episode_steps / hyper.steps_per_update) if ended else 0
    return int(steps > hyper.exploration_steps and steps % hyper.steps_per_update == 0)
