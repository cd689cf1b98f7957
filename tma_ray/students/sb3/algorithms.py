"""Any stable-baselines3 or sb3-contrib algorithm for continuous actions as a student, by its name.

Acting and updating are the library's own; the loop, the buffers, the randomness and the files are ours.
Nothing is normalised, as in the algorithm's own `learn`.
"""

from __future__ import annotations

import importlib
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from torch import nn

from tma_ray.hyperparameters import identifying
from tma_ray.registry import UnknownNameError
from tma_ray.students.base import Actions, Observations, Policy, Student, Transition
from tma_ray.students.layers import acting_layers
from tma_ray.students.mlp.network import as_batch
from tma_ray.students.policy_files import read_policy
from tma_ray.students.replay import ReplayBuffer
from tma_ray.students.rollout import Rollout
from tma_ray.students.sb3.algorithm_hyperparameters import hyperparameters_of
from tma_ray.students.sb3.algorithm_models import acting_tensors, make_model, stored_model
from tma_ray.students.sb3.algorithm_names import ALGORITHMS, PACKAGES
from tma_ray.students.sb3.stable_baselines import Experience, StableBaselinesStudent


@cache
def student_of(name: str) -> type[Student]:
    """Returns the student that the algorithm called `name` is.

    Raises:
        UnknownNameError: the package that offers it is not installed.
    """
    module = ALGORITHMS[name]
    try:
        algorithm: type[BaseAlgorithm] = getattr(importlib.import_module(module), name)
    except ModuleNotFoundError as error:
        if error.name != module:
            raise
        package = PACKAGES[module]
        raise UnknownNameError(
            f"student {name!r} is part of {package}, which is not installed: pip install {package}"
        ) from error
    return as_student(algorithm)


def as_student(algorithm: type[BaseAlgorithm]) -> type[Student]:
    """Returns the student that an algorithm is, one of your own included.

    Its hyper-parameters are the arguments of its constructor, and of those that this one passes its
    ``**keywords`` on to.

    Args:
        algorithm: for continuous actions, without memory; derived from one of stable-baselines3.
    """
    on_policy = issubclass(algorithm, OnPolicyAlgorithm)
    members = {
        "__doc__": f"{algorithm.__name__} of {algorithm.__module__}.",
        "__module__": __name__,
        "algorithm": algorithm,
        "hyperparameters_type": hyperparameters_of(algorithm, off_policy=not on_policy),
    }
    return type(algorithm.__name__, (OnPolicyStudent if on_policy else OffPolicyStudent,), members)


class AlgorithmStudent(StableBaselinesStudent[Any, Any]):
    """Base of the students of on-policy and of off-policy algorithms.

    Attributes:
        algorithm: constructs the model.
    """

    algorithm_version = 1
    algorithm: ClassVar[type[BaseAlgorithm]]

    def _make_model(self) -> BaseAlgorithm:
        boxes = self.observation_space, self.action_space
        return make_model(self.algorithm, *boxes, self.hyperparameters, self.device)

    def _refresh(self) -> None:
        """Nothing is copied from the model."""

    def act_greedily(self, observations: Observations) -> Actions:  # noqa: D102
        actions: Actions = self.model.predict(observations, deterministic=True)[0]
        return actions

    def sample_actions(self, observations: Observations, rng: np.random.Generator) -> Actions:  # noqa: D102
        with torch.random.fork_rng():
            torch.manual_seed(int(rng.integers(2**62)))
            actions: Actions = self.model.predict(observations, deterministic=False)[0]
        return actions

    def _predict(self, observation: Observations) -> Actions:
        """Returns an action (a,) of the exploring policy, drawn from the student's own stream."""
        with self._torch_stream.active():
            action: Actions = self.model.predict(observation, deterministic=False)[0]
        return action

    def save_policy(self, folder: Path) -> None:
        """Writes the tensors that acting needs, by stable-baselines3's names, and all hyper-parameters."""
        tensors = {name: tensor.numpy(force=True) for name, tensor in acting_tensors(self.model).items()}
        values = identifying(self.hyperparameters)
        self._write_policy(folder, self.algorithm.__name__, tensors, values)

    @classmethod
    def load_policy(cls, folder: Path, device: str = "cpu") -> Policy:  # noqa: D102
        model = cls._stored_model(folder, device)
        return lambda observations: model.predict(observations, deterministic=True)[0]

    @classmethod
    def policy_layers(cls, folder: Path) -> nn.Sequential:  # noqa: D102
        return acting_layers(cls._stored_model(folder, "cpu"))

    @classmethod
    def _stored_model(cls, folder: Path, device: str) -> BaseAlgorithm:
        stored = read_policy(folder, cls.algorithm.__name__)
        return stored_model(cls.algorithm, cls.hyperparameters_type, stored, device)


class OnPolicyStudent(AlgorithmStudent):
    """An algorithm that updates from `n_steps` consecutive steps."""

    def _start(self) -> None:
        sizes = self.observation_space.shape[0], self.action_space.shape[0]
        self._rollout = Rollout(self.hyperparameters.n_steps, *sizes, self._batches, self.device)

    def _connect(self) -> None:
        self.model.rollout_buffer = self._rollout
        self._rollout.clear()

    def act(self, observation: Observations) -> Actions:  # noqa: D102
        with self._torch_stream.active(), torch.no_grad():
            sampled, value, log_probability = self.model.policy(as_batch(observation, self.device))
        self._sampled: Actions = sampled.numpy(force=True)[0]
        self._judged = value.item(), log_probability.item()
        clipped: Actions = np.clip(self._sampled, self._low, self._high)
        return clipped

    def observe(self, transition: Transition) -> None:  # noqa: D102
        ended = transition.terminated or transition.truncated
        reward = transition.reward
        if transition.truncated and not transition.terminated:
            reward += self.gamma * self.state_values(transition.next_observation[None]).item()
        self._rollout.add(transition.observation, self._sampled, reward, ended, self._judged)
        if self._rollout.is_full:
            self._train(transition.next_observation)

    def state_values(self, observations: Observations) -> NDArray[np.float64]:  # noqa: D102
        with torch.no_grad():
            values = self.model.policy.predict_values(as_batch(observations, self.device))
        state_values: NDArray[np.float64] = values[:, 0].numpy(force=True).astype(np.float64)
        return state_values

    def _train(self, next_observation: Observations) -> None:
        last_value = self.state_values(next_observation[None])[0]
        self._rollout.finish(last_value, self.gamma, self.hyperparameters.gae_lambda)
        with self._updating():
            self.model.train()
        self._rollout.clear()

    def _save_experience(self, folder: Path, _incremental: bool) -> Experience:
        np.savez(folder / "rollout.npz", **self._rollout.state())
        return Experience({})

    def _load_experience(self, folder: Path, _counters: dict[str, Any]) -> None:
        with np.load(folder / "rollout.npz") as state:
            self._rollout.restore(dict(state))


class OffPolicyStudent(AlgorithmStudent):
    """An algorithm that updates from a replay buffer, after `learning_starts` steps of uniform actions."""

    def _start(self) -> None:
        sizes = self.observation_space.shape[0], self.action_space.shape[0]
        self._replay = ReplayBuffer(self.hyperparameters.buffer_size, *sizes, self._batches, self.device)
        self._steps = 0

    def _make_model(self) -> BaseAlgorithm:
        model: Any = super()._make_model()
        model.replay_buffer = self._replay
        return model  # type: ignore[no-any-return]

    def _connect(self) -> None:
        self._replay.clear()

    def act(self, observation: Observations) -> Actions:  # noqa: D102
        hyper = self.hyperparameters
        if self._steps < hyper.learning_starts:
            return self._exploration.uniform(self._low, self._high).astype(np.float32)
        action = self._predict(observation)
        return self._disturbed(action, self._noise()) if hyper.exploration_deviation else action

    def sample_actions(self, observations: Observations, rng: np.random.Generator) -> Actions:  # noqa: D102
        shape = len(observations), self._low.size
        if self._steps < self.hyperparameters.learning_starts:
            return rng.uniform(self._low, self._high, shape).astype(np.float32)
        actions = super().sample_actions(observations, rng)
        if not self.hyperparameters.exploration_deviation:
            return actions
        return self._disturbed(actions, rng.standard_normal(shape, dtype=np.float32))

    def _disturbed(self, actions: Actions, noise: NDArray[np.float32]) -> Actions:
        """Returns `actions` (..., a) with standard normal `noise` added, in the algorithm's measure."""
        deviation = np.float32(self.hyperparameters.exploration_deviation / 2) * (self._high - self._low)
        disturbed: Actions = np.clip(actions + deviation * noise, self._low, self._high)
        return disturbed

    def observe(self, transition: Transition) -> None:  # noqa: D102
        scaled = 2 * ((transition.action - self._low) / (self._high - self._low)) - 1
        self._replay.add(transition, scaled)
        self._steps += 1
        hyper = self.hyperparameters
        if self._steps > hyper.learning_starts and self._steps % hyper.train_freq == 0:
            count = hyper.gradient_steps if hyper.gradient_steps >= 0 else hyper.train_freq
            with self._updating():
                self.model.train(gradient_steps=count, batch_size=hyper.batch_size)

    def state_values(self, observations: Observations) -> NDArray[np.float64]:
        """Returns V(s) (n,): the critics' smallest value of the policy's actions, entropy bonus included.

        A stochastic policy's is averaged over actions drawn for it.
        """
        model, inputs = self.model, as_batch(observations, self.device)
        model.policy.set_training_mode(False)
        with torch.no_grad(), torch.random.fork_rng():
            if not hasattr(model.actor, "action_log_prob"):
                values: NDArray[np.float64]
                values = self._smallest(inputs, model.actor(inputs)).double().numpy(force=True)
                return values
            torch.manual_seed(int(self._values.integers(2**62)))
            log_coefficient = getattr(model, "log_ent_coef", None)
            alpha = model.ent_coef_tensor if log_coefficient is None else log_coefficient.exp()
            total = torch.zeros(len(inputs), dtype=torch.float64, device=self.device)
            for _ in range(self.hyperparameters.value_samples):
                actions, log_probabilities = model.actor.action_log_prob(inputs)
                total += self._smallest(inputs, actions) - alpha * log_probabilities.reshape(-1)
        averages: NDArray[np.float64] = (total / self.hyperparameters.value_samples).numpy(force=True)
        return averages

    def _smallest(self, inputs: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        values = self.model.critic(inputs, actions)
        if isinstance(values, torch.Tensor):  # quantiles (n, critics, q), whose mean is the value
            return values.mean(dim=(1, 2))
        return torch.cat(values, dim=1).amin(dim=1)

    def _save_experience(self, folder: Path, incremental: bool) -> Experience:
        return Experience({"steps": self._steps}, self._replay.save(folder, incremental))

    def _load_experience(self, folder: Path, counters: dict[str, Any]) -> None:
        self._replay.load(folder)
        self._steps = counters["steps"]
