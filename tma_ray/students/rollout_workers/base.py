"""Base classes of rollout workers and other students that act with a network, importable without torch."""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tma_ray.students.base import Actions, Observations, Policy, Student, StudentStreams
from tma_ray.students.mlp.acting import ArrayNetwork, FloatArray, RowNetwork
from tma_ray.students.rollout_workers.link import JoinRequest, LearnerLink, Weights, WorkerState

if TYPE_CHECKING:
    from gymnasium import spaces


class ActingNetwork(Protocol):
    """Interface of networks that compute actions: `ArrayNetwork` and `GreedyNetwork`."""

    row: RowNetwork

    def __call__(self, observations: Observations, squash: bool) -> Actions:
        """Return the mean actions (n, a) for `observations` (n, o), squashed by tanh if `squash`."""

    def outputs(self, observations: Observations) -> FloatArray:
        """Return all outputs (n, h) for `observations` (n, o)."""


class ActingStudent(Student):
    """Base class of students that act with a network in box spaces.

    They have one random generator per purpose.
    """

    _acting: ActingNetwork

    def _set_up(
        self,
        observation_space: spaces.Box,
        action_space: spaces.Box,
        hyperparameters: Any,
        seed: np.random.SeedSequence,
    ) -> StudentStreams:
        """Set the spaces, hyper-parameters and generators, and return the seeds spawned from `seed`."""
        self.observation_space, self.action_space = observation_space, action_space
        self._low = np.asarray(action_space.low, dtype=np.float32)
        self._high = np.asarray(action_space.high, dtype=np.float32)
        self.hyperparameters = hyperparameters
        self.gamma = hyperparameters.gamma
        streams = StudentStreams.of(seed)
        seeds = streams.exploration, streams.batches, streams.values
        self._generators = [np.random.default_rng(stream) for stream in seeds]
        self._exploration, self._batches, self._values = self._generators
        return streams

    @abstractmethod
    def _start(self) -> None:
        """Create the state kept across resets (statistics, step counts), and the experience buffer."""

    def _noise(self) -> NDArray[np.float32]:
        """Return standard normal noise (a,) for an exploring action."""
        return self._exploration.standard_normal(self._low.size, dtype=np.float32)


class RolloutWorker(ActingStudent):
    """Student that sends experience to the learner of a cohort, and acts with the weights it gets back.

    Runs use it like any student: `observe` returns after the updates due. Its files have the format
    of the same student outside a cohort.
    """

    _acting: ArrayNetwork

    def __init__(self, request: JoinRequest, link: LearnerLink) -> None:
        space, action_space = request.observation_space, request.action_space
        self._set_up(space, action_space, request.hyperparameters, request.seed)
        layout = self.hyperparameters.layout(space.shape[0], self._low.size)
        self._acting = ArrayNetwork(layout, self._low.size)
        self._link = link
        self._start()
        self._load_weights(link.join(request))

    @abstractmethod
    def _load_weights(self, weights: Weights) -> None:
        """Start acting with new `weights`."""

    @abstractmethod
    def _forget(self) -> None:
        """Discard experience that has not been sent yet."""

    @abstractmethod
    def experience(self) -> dict[str, Any]:
        """Return the counters, statistics and stored steps to save in a `WorkerState`."""

    @abstractmethod
    def restore_experience(self, experience: dict[str, Any]) -> None:
        """Restore values that `experience` returned at the end of an episode."""

    def reset(self) -> None:  # noqa: D102
        self._forget()
        self._load_weights(self._link.ask("reset"))

    def save(self, folder: Path, incremental: bool = False) -> tuple[str, ...]:  # noqa: D102
        unchanged: tuple[str, ...] = self._link.ask("save", folder, self._state(), incremental)
        return unchanged

    def load(self, folder: Path) -> None:  # noqa: D102
        weights, state = self._link.ask("load", folder)
        self._forget()
        self._load_weights(weights)
        for generator, saved in zip(self._generators, state.generators, strict=True):
            generator.bit_generator.state = saved
        self.restore_experience(state.experience)

    def save_policy(self, folder: Path) -> None:  # noqa: D102
        self._link.ask("save_policy", folder, self._state())

    @classmethod
    def load_policy(cls, folder: Path, device: str = "cpu") -> Policy:
        """Raise an error that refers to `tma_ray.students.load_policy`."""
        raise NotImplementedError("load the policy with tma_ray.students.load_policy")

    def _state(self) -> WorkerState:
        states: list[dict[str, Any]] = [dict(rng.bit_generator.state) for rng in self._generators]
        return WorkerState(states, self.experience())
