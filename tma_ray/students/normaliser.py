"""Running normalisation of observations and rewards, equal to stable-baselines3's VecNormalize."""

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tma_ray.students.base import Observations, Transition
from tma_ray.support.jit import kernel

EPSILON = 1e-8  # added to variances before taking the square root
INITIAL_COUNT = 1e-4  # weight of the initial mean 0 and variance 1

MEAN_TENSOR, VARIANCE_TENSOR = "normaliser.mean", "normaliser.variance"  # names in saved policies
COUNT_TENSOR = "normaliser.count"


class Normaliser:
    """Normalisation of observations and rewards by running statistics.

    Rewards are divided by the standard deviation of the discounted return. Bit for bit equal to
    VecNormalize over one environment, and several times as fast. Statistics are float64, results float32.
    """

    def __init__(self, size: int, gamma: float, observation_clip: float, reward_clip: float) -> None:
        self.gamma = gamma
        self.observation_clip = observation_clip
        self.reward_clip = reward_clip
        self._mean = np.zeros(size)
        self._variance = np.ones(size)
        self._count = INITIAL_COUNT
        self._return_mean, self._return_variance, self._return_count = 0.0, 1.0, INITIAL_COUNT
        self._discounted_return = 0.0

    def update(self, observation: Observations) -> None:
        """Update the statistics with one observation (o,)."""
        _count_in(observation, self._mean, self._variance, self._count)
        self._count += 1

    def update_reward(self, reward: float) -> None:
        """Update the statistics with one reward of the current episode."""
        self._discounted_return = self._discounted_return * self.gamma + reward
        count = self._return_count
        total = count + 1
        delta = self._discounted_return - self._return_mean
        self._return_mean += delta / total
        self._return_variance = (self._return_variance * count + delta * delta * count / total) / total
        self._return_count = total

    def end_episode(self) -> None:
        """Reset the discounted return for the next episode."""
        self._discounted_return = 0.0

    def update_step(self, transition: Transition, value: Callable[[Observations], float]) -> float:
        """Update all statistics with a step, and return its normalised reward.

        The last reward of a truncated episode includes the discounted `value` of its last observation.
        """
        ended = transition.terminated or transition.truncated
        if not ended:
            self.update(transition.next_observation)
        self.update_reward(transition.reward)
        reward = self.normalise_reward(transition.reward)
        if ended:
            self.end_episode()
        if transition.truncated and not transition.terminated:
            reward += self.gamma * value(transition.next_observation)
        return reward

    def normalise(self, observations: Observations) -> Observations:
        """Return `observations` (..., o), normalised and clipped."""
        rows = np.ascontiguousarray(observations).reshape(-1, len(self._mean))
        return scaled(rows, *self.statistics).reshape(observations.shape)

    @property
    def statistics(self) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
        """Arguments of `scaled` other than the observations."""
        return self._mean, self._variance, self.observation_clip

    def normalise_reward(self, reward: float) -> float:
        """Return `reward`, scaled and clipped, without subtracting a mean."""
        return max(-self.reward_clip, min(self.reward_clip, reward / self.reward_scale))

    @property
    def reward_scale(self) -> float:
        """Standard deviation by which rewards are divided."""
        return math.sqrt(self._return_variance + EPSILON)

    def save(self, path: Path) -> None:
        """Write all statistics as JSON."""
        content = {
            "observation_mean": self._mean.tolist(),
            "observation_variance": self._variance.tolist(),
            "observation_count": self._count,
            "observation_clip": self.observation_clip,
            "epsilon": EPSILON,
            "return_mean": self._return_mean,
            "return_variance": self._return_variance,
            "return_count": self._return_count,
            "discounted_return": self._discounted_return,
            "reward_clip": self.reward_clip,
            "gamma": self.gamma,
        }
        path.write_text(json.dumps(content, indent=1))

    def tensors(self) -> dict[str, NDArray[np.float64]]:
        """Return the observation statistics by their names in a saved policy."""
        return {
            MEAN_TENSOR: self._mean,
            VARIANCE_TENSOR: self._variance,
            COUNT_TENSOR: np.array(self._count, dtype=np.float64),
        }

    @staticmethod
    def tensor_specs(size: int) -> dict[str, tuple[tuple[int, ...], str]]:
        """Return the shapes and types of `tensors` by name, for observations of length `size`."""
        shapes = {MEAN_TENSOR: (size,), VARIANCE_TENSOR: (size,), COUNT_TENSOR: ()}
        return {name: (shape, "float64") for name, shape in shapes.items()}

    @classmethod
    def load(cls, path: Path) -> "Normaliser":
        """Return a normaliser written by `save`."""
        content = json.loads(path.read_text())
        mean: NDArray[np.float64] = np.array(content["observation_mean"])
        normaliser = cls(mean.size, content["gamma"], content["observation_clip"], content["reward_clip"])
        normaliser._mean = mean
        normaliser._variance = np.array(content["observation_variance"])
        normaliser._count = content["observation_count"]
        normaliser._return_mean = content["return_mean"]
        normaliser._return_variance = content["return_variance"]
        normaliser._return_count = content["return_count"]
        normaliser._discounted_return = content["discounted_return"]
        return normaliser


@kernel
def _count_in(
    observation: Observations, mean: NDArray[np.float64], variance: NDArray[np.float64], count: float
) -> None:
    total = count + 1
    for k in range(len(mean)):
        delta = observation[k] - mean[k]
        mean[k] += delta / total
        variance[k] = (variance[k] * count + delta * delta * count / total) / total


@kernel
def scaled(
    observations: Observations, mean: NDArray[np.float64], variance: NDArray[np.float64], clip: float
) -> Observations:
    """Return `observations` (n, o), normalised and clipped."""
    deviation = np.sqrt(variance + EPSILON)
    results = np.empty(observations.shape, dtype=np.float32)
    for row in range(len(observations)):
        for k in range(len(mean)):
            value = (observations[row, k] - mean[k]) / deviation[k]
            results[row, k] = min(max(value, -clip), clip)
    return results
