"""Students made from any stable-baselines3 or sb3-contrib algorithm for continuous actions.

Acting and updating are the library's; the loop, buffers, randomness and files are ours. Nothing is
normalised, as in the algorithm's `learn`.
"""

import copy
import dataclasses
import importlib
import inspect
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3 import TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from torch import nn
from torch.nn.modules.module import register_module_parameter_registration_hook

from tma_ray.components.registry import UnknownNameError
from tma_ray.components.settings import config_dict, parse_settings
from tma_ray.students.base import Actions, Observations, Policy, Student, Transition
from tma_ray.students.hyperparameters import ALGORITHMS, PACKAGES, MatmulPrecision
from tma_ray.students.layers import acting_layers
from tma_ray.students.mlp.network import as_batch
from tma_ray.students.policy_files import read_policy, write_policy
from tma_ray.students.replay import ReplayBuffer
from tma_ray.students.rollout_workers.ppo import Rollout
from tma_ray.students.sb3.base import StableBaselinesStudent, single_precision

EXCLUDED_ARGUMENTS = frozenset(
    {
        *("self", "policy", "env", "seed", "device", "verbose", "tensorboard_log", "stats_window_size"),
        *("_init_setup_model", "monitor_wrapper", "support_multi_env", "supported_action_spaces"),
        *("replay_buffer_class", "replay_buffer_kwargs", "rollout_buffer_class", "rollout_buffer_kwargs"),
        *("optimize_memory_usage", "action_noise", "n_steps_return"),
        *("use_sde", "sde_sample_freq", "use_sde_at_warmup"),
    }
)
"""Constructor arguments that the student sets, or that configure its loop and buffers."""

_POSITIVE = ("learning_rate", "buffer_size", "batch_size", "train_freq", "n_steps")


def hyperparameters_of(algorithm: type[BaseAlgorithm], off_policy: bool) -> type:
    """Return a frozen dataclass whose fields are the constructor arguments of `algorithm`.

    Args:
        algorithm: algorithm of stable-baselines3, or one that follows its conventions.
        off_policy: True if it learns from a replay buffer. The dataclass then has ``exploration_deviation``,
            the deviation of normal noise on actions scaled to [-1, 1]: 0.1 for deterministic policies (TD3's
            paper, arXiv:1802.09477), else 0.
    """
    excluded = EXCLUDED_ARGUMENTS | ({"n_steps"} if off_policy else frozenset())
    # include the arguments of base constructors, up to the first without **keywords
    arguments: dict[str, inspect.Parameter] = {}
    for constructor in filter(None, (vars(base).get("__init__") for base in algorithm.__mro__)):
        parameters = inspect.signature(constructor).parameters
        kinds = {parameter.kind for parameter in parameters.values()}
        arguments = {**parameters, **arguments}
        if inspect.Parameter.VAR_KEYWORD not in kinds:
            break
    fields: list[tuple[str, Any, Any]] = []
    for name, parameter in arguments.items():
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            continue
        if name not in excluded:
            default = parameter.default
            kind = type(default) if type(default) in (bool, int, float) else Any
            fields.append((name, kind, dataclasses.field(default=default)))
    if off_policy:
        deviation = 0.1 if issubclass(algorithm, TD3) else 0.0
        fields.append(("exploration_deviation", float, dataclasses.field(default=deviation)))
        fields.append(("value_samples", int, dataclasses.field(default=16)))
    precision = dataclasses.field(default=MatmulPrecision.HIGHEST)
    fields.append(("matmul_precision", MatmulPrecision, precision))
    name = f"{algorithm.__name__}Hyperparameters"
    return dataclasses.make_dataclass(name, fields, frozen=True, namespace={"__post_init__": _check})


def _check(hyperparameters: Any) -> None:
    for name in _POSITIVE:
        value = getattr(hyperparameters, name, 1)
        if isinstance(value, (int, float)) and value <= 0:
            raise ValueError(f"hyper-parameter {name} = {value!r}: expected more than 0")
    deviation = getattr(hyperparameters, "exploration_deviation", 0)
    if deviation < 0:
        raise ValueError(f"hyper-parameter exploration_deviation = {deviation}: expected 0 or more")


MOST_PARAMETERS = 100_000_000  # largest number of parameters of a saved policy's model (400 MB)


class SpacesOnly(gymnasium.Env[Any, Any]):
    """Placeholder environment that only provides spaces to a model."""

    def __init__(self, observation_space: spaces.Box, action_space: spaces.Box) -> None:
        self.observation_space = observation_space
        self.action_space = action_space


def make_model(
    algorithm: type[BaseAlgorithm],
    observation_space: spaces.Box,
    action_space: spaces.Box,
    hyperparameters: Any,
    device: torch.device,
) -> BaseAlgorithm:
    """Return a model of `algorithm` whose networks are not built yet."""
    added = {"exploration_deviation", "value_samples", "matmul_precision"}
    names = [field.name for field in dataclasses.fields(hyperparameters)]
    constructor: Any = algorithm
    model: BaseAlgorithm = constructor(
        "MlpPolicy",
        SpacesOnly(observation_space, action_space),
        device=device,
        _init_setup_model=False,
        **{name: copy.deepcopy(getattr(hyperparameters, name)) for name in names if name not in added},
    )
    return model


def acting_tensors(model: BaseAlgorithm) -> dict[str, torch.Tensor]:
    """Return the tensors of the greedy policy, named as in the state dict of the policy of `model`.

    For off-policy algorithms of the libraries that is the actor, for any other the whole state.
    """
    state: dict[str, torch.Tensor] = model.policy.state_dict()
    packages = {type(part).__module__.split(".")[0] for part in (model, model.policy)}
    if packages <= {*PACKAGES} and isinstance(model, OffPolicyAlgorithm):
        return {name: tensor for name, tensor in state.items() if name.startswith("actor.")}
    return state


@contextmanager
def _bounded() -> Iterator[None]:
    """Context manager in which building networks of over `MOST_PARAMETERS` parameters raises a ValueError."""
    count = 0

    def weigh(_module: nn.Module, _name: str, parameter: nn.Parameter | None) -> None:
        nonlocal count
        count += 0 if parameter is None else parameter.numel()
        if count > MOST_PARAMETERS:
            raise ValueError(f"its networks would have more than {MOST_PARAMETERS:,} parameters")

    hook = register_module_parameter_registration_hook(weigh)
    try:
        yield
    finally:
        hook.remove()


@cache
def student_of(name: str) -> type[Student]:
    """Return the student class for the algorithm called `name`, or raise an UnknownNameError."""
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
    """Return a student class for `algorithm`, which must support continuous actions; it may be user-defined.

    Its hyper-parameters are the constructor's arguments, with those of base constructors that it passes
    ``**keywords`` to.
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
    """Base class of `OnPolicyStudent` and `OffPolicyStudent`.

    Attributes:
        algorithm: class of the model.
    """

    algorithm_version = 1
    algorithm: ClassVar[type[BaseAlgorithm]]

    def _make_model(self) -> BaseAlgorithm:
        boxes = self.observation_space, self.action_space
        return make_model(self.algorithm, *boxes, self.hyperparameters, self.device)

    def _refresh(self) -> None:
        """Do nothing, since the model itself acts."""

    def act_greedily(self, observations: Observations) -> Actions:  # noqa: D102
        actions: Actions = self.model.predict(observations, deterministic=True)[0]
        return actions

    def sample_actions(self, observations: Observations, rng: np.random.Generator) -> Actions:  # noqa: D102
        with torch.random.fork_rng():
            torch.manual_seed(int(rng.integers(2**62)))
            actions: Actions = self.model.predict(observations, deterministic=False)[0]
        return actions

    def save_policy(self, folder: Path) -> None:
        """Write the tensors of the greedy policy and all hyper-parameters."""
        tensors = {name: tensor.numpy(force=True) for name, tensor in acting_tensors(self.model).items()}
        values = config_dict(self.hyperparameters)
        spaces = self.observation_space, self.action_space
        write_policy(folder, self.algorithm.__name__, *spaces, tensors, values)

    @classmethod
    def load_policy(cls, folder: Path, device: str = "cpu") -> Policy:  # noqa: D102
        model = cls._stored_model(folder, device)
        return lambda observations: model.predict(observations, deterministic=True)[0]

    @classmethod
    def policy_layers(cls, folder: Path) -> nn.Sequential:  # noqa: D102
        return acting_layers(cls._stored_model(folder, "cpu"))

    @classmethod
    def _stored_model(cls, folder: Path, device: str) -> BaseAlgorithm:
        """Return a model that contains the saved policy."""
        stored = read_policy(folder, cls.algorithm.__name__)
        boxes = stored.observation_space, stored.action_space
        try:
            values = parse_settings(cls.hyperparameters_type, {}, stored.hyperparameters)
            hyperparameters: Any = cls.hyperparameters_type(**values)
            model: Any = make_model(cls.algorithm, *boxes, hyperparameters, torch.device("cpu"))
            if isinstance(model, OffPolicyAlgorithm):
                model.replay_buffer = object()  # type: ignore[assignment]  # the model only acts
            # fork the RNG, since setting up the model draws random initial weights
            with single_precision(), torch.random.fork_rng(), _bounded():
                model._setup_model()
        except Exception as error:  # any error, since the saved values are unchecked
            name = cls.algorithm.__name__
            stored.refuse(f"no {name} can be made of its hyper-parameters: {error!r:.200}")
        acting = acting_tensors(model)
        stored.check(
            {name: (tuple(x.shape), str(x.dtype).removeprefix("torch.")) for name, x in acting.items()}
        )
        with torch.no_grad():
            for name, tensor in acting.items():
                tensor.copy_(torch.from_numpy(stored.tensors[name]))
        model.device = torch.device(device)
        model.policy.to(model.device)
        return model  # type: ignore[no-any-return]


class OnPolicyStudent(AlgorithmStudent):
    """Base class of students that learn from rollouts of `n_steps` steps."""

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
        self._evaluation = value.item(), log_probability.item()
        clipped: Actions = np.clip(self._sampled, self._low, self._high)
        return clipped

    def observe(self, transition: Transition) -> None:  # noqa: D102
        ended = transition.terminated or transition.truncated
        reward = transition.reward
        if transition.truncated and not transition.terminated:
            reward += self.gamma * self.state_values(transition.next_observation[None]).item()
        self._rollout.add(transition.observation, self._sampled, reward, ended, self._evaluation)
        if self._rollout.is_full:
            last_value = self.state_values(transition.next_observation[None])[0]
            self._rollout.finish(last_value, self.gamma, self.hyperparameters.gae_lambda)
            with self._updating():
                self.model.train()
            self._rollout.clear()

    def state_values(self, observations: Observations) -> NDArray[np.float64]:  # noqa: D102
        with torch.no_grad():
            values = self.model.policy.predict_values(as_batch(observations, self.device))
        state_values: NDArray[np.float64] = values[:, 0].numpy(force=True).astype(np.float64)
        return state_values

    def _save_experience(self, folder: Path, _incremental: bool) -> tuple[dict[str, Any], tuple[str, ...]]:
        np.savez(folder / "rollout.npz", **self._rollout.state())
        return {}, ()

    def _load_experience(self, folder: Path, _counters: dict[str, Any]) -> None:
        with np.load(folder / "rollout.npz") as state:
            self._rollout.restore(dict(state))


class OffPolicyStudent(AlgorithmStudent):
    """Base class of students that learn from a replay buffer after `learning_starts` uniform actions."""

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
        with self._torch_stream.active():
            action: Actions = self.model.predict(observation, deterministic=False)[0]
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
        """Return `actions` (..., a) plus scaled standard normal `noise`, clipped to the action space."""
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
        """Return V(s) (n,), the critics' minimum averaged over sampled actions, plus the entropy bonus."""
        model, inputs = self.model, as_batch(observations, self.device)
        model.policy.set_training_mode(False)
        with torch.no_grad(), torch.random.fork_rng():
            if not hasattr(model.actor, "action_log_prob"):
                smallest = self._smallest(inputs, model.actor(inputs))
                values: NDArray[np.float64] = smallest.double().numpy(force=True)
                return values
            torch.manual_seed(int(self._values.integers(2**62)))
            total = torch.zeros(len(inputs), dtype=torch.float64, device=self.device)
            for _ in range(self.hyperparameters.value_samples):
                actions, log_probabilities = model.actor.action_log_prob(inputs)
                total += self._smallest(inputs, actions) - self._temperature() * log_probabilities.reshape(-1)
        averages: NDArray[np.float64] = (total / self.hyperparameters.value_samples).numpy(force=True)
        return averages

    def entropy_bonuses(self, observations: Observations) -> NDArray[np.float64]:  # noqa: D102
        model, inputs = self.model, as_batch(observations, self.device)
        if not hasattr(model.actor, "action_log_prob"):
            return super().entropy_bonuses(observations)
        model.policy.set_training_mode(False)
        with torch.no_grad(), torch.random.fork_rng():
            torch.manual_seed(0)  # a fixed seed, since the student's generators must not advance
            draws = range(self.hyperparameters.value_samples)
            densities = torch.stack([model.actor.action_log_prob(inputs)[1].double() for _ in draws])
            return (-self._temperature() * densities.mean(dim=0).reshape(-1)).numpy(force=True)

    def _temperature(self) -> torch.Tensor:
        log_coefficient = getattr(self.model, "log_ent_coef", None)
        coefficient: torch.Tensor
        coefficient = self.model.ent_coef_tensor if log_coefficient is None else log_coefficient.exp()
        return coefficient

    def _smallest(self, inputs: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        values = self.model.critic(inputs, actions)
        if isinstance(values, torch.Tensor):  # quantiles (n, critics, q) of TQC
            return values.mean(dim=(1, 2))
        return torch.cat(values, dim=1).amin(dim=1)

    def _save_experience(self, folder: Path, incremental: bool) -> tuple[dict[str, Any], tuple[str, ...]]:
        return {"steps": self._steps}, self._replay.save(folder, incremental)

    def _load_experience(self, folder: Path, counters: dict[str, Any]) -> None:
        self._replay.load(folder)
        self._steps = counters["steps"]
