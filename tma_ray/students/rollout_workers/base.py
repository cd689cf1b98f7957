"""The acting half of students, whether their networks learn here or elsewhere. Imports no torch."""

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
    """The network that a student acts with: an `ArrayNetwork`, or one of torch."""

    row: RowNetwork

    def __call__(self, observations: Observations, squash: bool) -> Actions:
        """Return the mean actions (n, a) of `observations` (n, o), or their tangent hyperbolic."""

    def outputs(self, observations: Observations) -> FloatArray:
        """Return all outputs (n, h) for `observations` (n, o)."""


class ActingStudent(Student):
    """A student between two boxes, whose randomness comes from the streams of its seed."""

    _acting: ActingNetwork

    def _set_up(
        self,
        observation_space: spaces.Box,
        action_space: spaces.Box,
        hyperparameters: Any,
        seed: np.random.SeedSequence,
    ) -> StudentStreams:
        """Set spaces, hyper-parameters and generators; return the streams of the seed."""
        self.observation_space, self.action_space = observation_space, action_space
        self._low = np.asarray(action_space.low, dtype=np.float32)
        self._high = np.asarray(action_space.high, dtype=np.float32)
        self.hyperparameters = hyperparameters
        self.gamma = hyperparameters.gamma
        streams = StudentStreams.of(seed)
        parts = streams.exploration, streams.batches, streams.values
        self._generators = [np.random.default_rng(part) for part in parts]
        self._exploration, self._batches, self._values = self._generators
        return streams

    @abstractmethod
    def _start(self) -> None:
        """Make what lives as long as the student: statistics, counters and empty memory for experience."""

    def _noise(self) -> NDArray[np.float32]:
        """Draw the standard normal noise (a,) of one exploring action."""
        return self._exploration.standard_normal(self._low.size, dtype=np.float32)


class RolloutWorker(ActingStudent):
    """Acting half of a student: mirrored weights, and experience for a learner that returns new ones.

    To its run it is a student like any other: `observe` returns when the updates that are due are made.
    Its files are those of the student that learns alone, and each loads what the other saved.

    Args:
        membership: facts that the learner needs.
        link: connection to the learner, which nobody else uses.
    """

    _acting: ArrayNetwork

    def __init__(self, membership: JoinRequest, link: LearnerLink) -> None:
        space, action_space = membership.observation_space, membership.action_space
        self._set_up(space, action_space, membership.hyperparameters, membership.seed)
        layout = self.hyperparameters.layout(space.shape[0], self._low.size)
        self._acting = ArrayNetwork(layout, self._low.size)
        self._link = link
        self._start()
        self._load_weights(link.join(membership))

    @abstractmethod
    def _load_weights(self, weights: Weights) -> None:
        """Act with `weights` from now on."""

    @abstractmethod
    def _forget(self) -> None:
        """Forget the experience since the last hand-over."""

    @abstractmethod
    def experience(self) -> dict[str, Any]:
        """Return counters, statistics and steps, for `WorkerState`."""

    @abstractmethod
    def restore_experience(self, experience: dict[str, Any]) -> None:
        """Load what `experience` returned, at the end of an episode."""

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
        """Raise an error, since only the student that learns alone loads policies."""
        raise NotImplementedError("load the policy with tma_ray.students.load_policy")

    def scalars(self) -> dict[str, float]:  # noqa: D102
        figures: dict[str, float] = self._link.ask("scalars")
        return figures

    def _state(self) -> WorkerState:
        states: list[dict[str, Any]] = [dict(each.bit_generator.state) for each in self._generators]
        return WorkerState(states, self.experience())
