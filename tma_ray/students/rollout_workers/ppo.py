"""Action selection, rollout buffer and rollout worker of PPO, importable without torch."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tma_ray.students.base import Actions, Observations, Transition
from tma_ray.students.hyperparameters import PPOHyperparameters
from tma_ray.students.mlp.acting import ArrayNetwork, FloatArray, RowArrays, apply_row
from tma_ray.students.normaliser import Normaliser, scaled
from tma_ray.students.rollout_workers.base import ActingNetwork, ActingStudent, RolloutWorker
from tma_ray.students.rollout_workers.link import Weights
from tma_ray.support.jit import kernel

if TYPE_CHECKING:
    import torch
    from stable_baselines3.common.type_aliases import RolloutBufferSamples


Floats = NDArray[np.float64]


class Step(NamedTuple):
    """Exploring action with the values stored for learning.

    Attributes:
        observation: normalised observation (o,).
        sampled: sampled action (a,).
        action: sampled action clipped to the action space (a,).
        evaluation: value of the observation in normalised reward, and log probability of `sampled`.
    """

    observation: Observations
    sampled: Actions
    action: Actions
    evaluation: tuple[float, float]


def exploring_step(
    network: RowArrays,
    policy: tuple[FloatArray, FloatArray],
    normaliser: Normaliser,
    observation: Observations,
    noise: FloatArray,
) -> Step:
    """Return an exploring action at `observation` (o,), with the values stored for learning.

    `policy` holds the log standard deviation (a,) and the bounds of actions (2, a); the `noise` (a,) is
    standard normal.
    """
    return Step(*_act(network, policy, normaliser.statistics, observation, noise))


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


class Rollout:
    """Rollout buffer of a fixed number of consecutive steps.

    It replaces stable-baselines3's buffer, whose updates read `values`, `returns` and the batches of
    `get`. Returns and advantages are bit for bit equal; shuffling uses `generator` instead of numpy's global
    one.
    """

    def __init__(
        self,
        steps: int,
        observation_size: int,
        action_size: int,
        generator: np.random.Generator,
        device: torch.device | None = None,
    ) -> None:
        self._generator = generator
        self._device = device
        self.observations = np.zeros((steps, observation_size), dtype=np.float32)
        self.actions = np.zeros((steps, action_size), dtype=np.float32)
        self.rewards = np.zeros(steps, dtype=np.float32)
        self.ended = np.zeros(steps, dtype=np.bool_)
        self.values = np.zeros(steps, dtype=np.float32)
        self.log_probabilities = np.zeros(steps, dtype=np.float32)
        self.advantages = np.zeros(steps, dtype=np.float32)
        self.returns = np.zeros(steps, dtype=np.float32)
        self._size = 0

    @property
    def is_full(self) -> bool:
        """True if the buffer is full."""
        return self._size == len(self.rewards)

    def clear(self) -> None:
        """Discard all steps."""
        self._size = 0

    def add(
        self,
        observation: Observations,
        action: Actions,
        reward: float,
        ended: bool,
        evaluation: tuple[float, float],
    ) -> None:
        """Append a step.

        Args:
            observation: normalised observation (o,).
            action: action before clipping (a,).
            reward: normalised reward, with the bootstrapped value of a truncated episode.
            ended: True for the last step of an episode.
            evaluation: value of the observation and log probability of the action.
        """
        index = self._size
        self.observations[index] = observation
        self.actions[index] = action
        self.rewards[index] = reward
        self.ended[index] = ended
        self.values[index], self.log_probabilities[index] = evaluation
        self._size = index + 1

    def finish(self, last_value: float, gamma: float, gae_lambda: float) -> None:
        """Compute returns and advantages by generalised advantage estimation (arXiv:1506.02438).

        `last_value` is the value of the observation after the last step.
        """
        continues = 1 - self.ended.astype(np.float32)
        next_values = np.append(self.values[1:], np.float32(last_value))
        errors = self.rewards + gamma * next_values * continues - self.values
        decays = gamma * gae_lambda * continues
        _discounted_sums(errors, decays, self.advantages)
        self.returns = self.advantages + self.values

    def get(self, batch_size: int | None = None) -> Iterator[RolloutBufferSamples]:
        """Yield all steps as tensors in shuffled mini-batches, or in one batch if `batch_size` is None."""
        import torch
        from stable_baselines3.common.type_aliases import RolloutBufferSamples

        order, columns = self.shuffled(), self.columns()
        for start in range(0, len(order), batch_size or len(order)):
            rows = order[start : start + (batch_size or len(order))]
            yield RolloutBufferSamples(*(torch.from_numpy(c[rows]).to(self._device) for c in columns))

    def shuffled(self) -> NDArray[np.int64]:
        """Return a random order (n,) of the steps for one epoch."""
        return self._generator.permutation(len(self.rewards))

    def columns(self) -> tuple[NDArray[np.float32], ...]:
        """Return the arrays of all n steps, in the order of the fields of `ppo.Steps`."""
        return (
            *(self.observations, self.actions, self.values),
            *(self.log_probabilities, self.advantages, self.returns),
        )

    def state(self) -> dict[str, Any]:
        """Return the arrays of the steps so far, by name."""
        return {name: getattr(self, name)[: self._size] for name in _STORED}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Load the `state` of another rollout."""
        self._size = len(state["rewards"])
        for name in _STORED:
            getattr(self, name)[: self._size] = state[name]


@kernel
def _discounted_sums(
    errors: NDArray[np.float32], decays: NDArray[np.float32], sums: NDArray[np.float32]
) -> None:
    total = np.float32(0)
    for index in range(len(errors) - 1, -1, -1):
        total = errors[index] + decays[index] * total
        sums[index] = total


_STORED = ("observations", "actions", "rewards", "ended", "values", "log_probabilities")


class PPOActing(ActingStudent):
    """Base class of PPO and its rollout worker, with normalisation, action selection and rollout buffer."""

    algorithm_version = PPOHyperparameters.algorithm_version
    hyperparameters_type = PPOHyperparameters
    hyperparameters: PPOHyperparameters
    device: torch.device | None = None

    _greedy: ActingNetwork
    _policy: tuple[FloatArray, FloatArray]

    def _start(self) -> None:
        hyper, size = self.hyperparameters, self.observation_space.shape[0]
        self.normaliser = Normaliser(size, hyper.gamma, hyper.observation_clip, hyper.reward_clip)
        self.rollout = Rollout(hyper.steps_per_update, size, self._low.size, self._batches, self.device)
        self._episode_starts = True

    @abstractmethod
    def _finish_rollout(self, next_observation: Observations) -> None:
        """Learn from the full rollout, and clear it."""

    @property
    @abstractmethod
    def average(self) -> FloatArray | None:
        """Moving average of the parameters (p,), or None if `averaged_steps` is 0."""

    @abstractmethod
    def put_average(self, average: FloatArray) -> None:
        """Set the moving `average` of the parameters (p,)."""

    def act(self, observation: Observations) -> Actions:  # noqa: D102
        if self._episode_starts:
            self.normaliser.update(observation)
        network = self._acting.row.arrays
        self._step = exploring_step(network, self._policy, self.normaliser, observation, self._noise())
        return self._step.action

    def observe(self, transition: Transition) -> None:  # noqa: D102
        ended = transition.terminated or transition.truncated
        reward = self.normaliser.update_step(transition, self._value)
        step = self._step
        self.rollout.add(step.observation, step.sampled, reward, ended, step.evaluation)
        self._episode_starts = ended
        if self.rollout.is_full:
            self._finish_rollout(transition.next_observation)

    def act_greedily(self, observations: Observations) -> Actions:  # noqa: D102
        means = self._greedy(self.normaliser.normalise(observations), squash=False)
        clipped: Actions = np.minimum(np.maximum(means, self._low), self._high)
        return clipped

    def sample_actions(self, observations: Observations, rng: np.random.Generator) -> Actions:  # noqa: D102
        means = self._acting(self.normaliser.normalise(observations), squash=False)
        log_deviation, (low, high) = self._policy
        sampled = means + np.exp(log_deviation) * rng.standard_normal(means.shape, dtype=np.float32)
        actions: Actions = np.minimum(np.maximum(sampled, low), high)
        return actions

    def _value(self, observation: Observations) -> float:
        """Return the value of `observation` (o,), in units of normalised rewards."""
        return float(self._acting.row(self.normaliser.normalise(observation))[-1])

    def experience(self) -> dict[str, Any]:
        """Return the normaliser, the rollout and the moving average, to be saved."""
        return {"normaliser": self.normaliser, "rollout": self.rollout.state(), "average": self.average}

    def restore_experience(self, experience: dict[str, Any]) -> None:
        """Restore values that `experience` returned at the end of an episode."""
        self.normaliser = experience["normaliser"]
        self.rollout.restore(experience["rollout"])
        if experience["average"] is not None:
            self.put_average(experience["average"])
        self._episode_starts = True


class PPORolloutWorker(PPOActing, RolloutWorker):
    """Rollout worker of `tma_ray.students.ppo.PPO` that sends whole rollouts to the learner."""

    _greedy: ArrayNetwork

    def _start(self) -> None:
        super()._start()
        self._average: FloatArray | None = None
        self._greedy = self._acting
        if self.hyperparameters.averaged_steps:
            self._greedy = ArrayNetwork(self._acting.layout, self._low.size)

    def _load_weights(self, weights: Weights) -> None:
        """Load new `weights`, and update the moving average of the parameters.

        The weights are the network's parameters, followed by the log standard deviation (a,).
        """
        count = self._low.size
        parameters = weights[:-count]
        self._acting.load(parameters)
        if self.hyperparameters.averaged_steps:
            average = parameters if self._average is None else self._average
            self.put_average(average + np.float32(self.hyperparameters.averaging) * (parameters - average))
        self._policy = weights[-count:].copy(), np.stack([self._low, self._high])

    @property
    def average(self) -> FloatArray | None:  # noqa: D102
        return self._average

    def put_average(self, average: FloatArray) -> None:  # noqa: D102
        self._average = average
        self._greedy.load(average)

    def _forget(self) -> None:
        self._average = None
        self.rollout.clear()

    def state_values(self, observations: Observations) -> NDArray[np.float64]:
        """Return V(s) (n,) of `observations` (n, o), rescaled from normalised to raw rewards."""
        outputs = self._acting.outputs(self.normaliser.normalise(observations))
        values: NDArray[np.float64] = outputs[:, -1].astype(np.float64) * self.normaliser.reward_scale
        return values

    def _finish_rollout(self, next_observation: Observations) -> None:
        hyper = self.hyperparameters
        self.rollout.finish(self._value(next_observation), self.gamma, hyper.gae_lambda)
        orders = np.stack([self.rollout.shuffled() for _ in range(hyper.epochs)])
        updates = hyper.epochs * (hyper.steps_per_update // hyper.batch_size)
        weights = self._link.learn((*self.rollout.columns(), orders), updates)
        assert weights is not None, "a full rollout brings updates"
        self._load_weights(weights)
        self.rollout.clear()
