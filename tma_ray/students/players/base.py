"""The acting half of a student whose learning half is elsewhere. Imports no torch."""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tma_ray.students.base import Policy, Student, StudentStreams
from tma_ray.students.mlp.acting import ArrayNetwork
from tma_ray.students.mlp.layout import Layout
from tma_ray.students.players.link import LearnerLink, Membership, PlayerState, Weights


class Player(Student):
    """Acting half of a student: mirrored weights, and experience for a learner that returns new ones.

    To its run it is a student like any other: `observe` returns when the updates that are due are made.
    Its files are those of the student that learns alone, and each loads what the other saved.

    Args:
        membership: facts that the learner needs.
        link: connection to the learner, which nobody else uses.
    """

    def __init__(self, membership: Membership, link: LearnerLink) -> None:
        self.hyperparameters = membership.hyperparameters
        self.gamma = membership.hyperparameters.gamma
        space, action_space = membership.observation_space, membership.action_space
        self._low = np.asarray(action_space.low, dtype=np.float32)
        self._high = np.asarray(action_space.high, dtype=np.float32)
        streams = StudentStreams.of(membership.seed)
        parts = streams.exploration, streams.batches, streams.values
        self._generators = [np.random.default_rng(part) for part in parts]
        self._exploration, self._batches, self._values = self._generators
        self._network = ArrayNetwork(self._layout(space.shape[0], self._low.size))
        self._link = link
        self._observation_size = space.shape[0]
        self._start()
        self._take_over(link.join(membership))

    @abstractmethod
    def _layout(self, observation: int, action: int) -> Layout:
        """Return the network that acts, given the lengths of observations and of actions."""

    @abstractmethod
    def _start(self) -> None:
        """Make what lives as long as the student: statistics, counters and empty memory for experience."""

    @abstractmethod
    def _take_over(self, weights: Weights) -> None:
        """Act with `weights` from now on."""

    @abstractmethod
    def _forget(self) -> None:
        """Forget the experience since the last hand-over."""

    @abstractmethod
    def _experience(self) -> dict[str, Any]:
        """Return counters, statistics and steps, for `PlayerState`."""

    @abstractmethod
    def _restore_experience(self, experience: dict[str, Any]) -> None:
        """Load what `_experience` returned, at the end of an episode."""

    def reset(self) -> None:  # noqa: D102
        self._forget()
        self._take_over(self._link.reset())

    def save(self, folder: Path, incremental: bool = False) -> tuple[str, ...]:  # noqa: D102
        return self._link.save(folder, self._state(), incremental)

    def load(self, folder: Path) -> None:  # noqa: D102
        weights, state = self._link.load(folder)
        self._forget()
        self._take_over(weights)
        for generator, saved in zip(self._generators, state.generators, strict=True):
            generator.bit_generator.state = saved
        self._restore_experience(state.experience)

    def save_policy(self, folder: Path) -> None:  # noqa: D102
        self._link.save_policy(folder, self._state())

    @classmethod
    def load_policy(cls, folder: Path, device: str = "cpu") -> Policy:
        """Refuse: policies are those of the student that learns alone, which loads them."""
        raise NotImplementedError("load the policy with tma_ray.students.load_policy")

    def scalars(self) -> dict[str, float]:  # noqa: D102
        return self._link.scalars()

    def _state(self) -> PlayerState:
        states: list[dict[str, Any]] = [dict(each.bit_generator.state) for each in self._generators]
        return PlayerState(states, self._experience())

    def _noise(self) -> NDArray[np.float32]:
        """Draw the standard normal noise (a,) of one exploring action."""
        return self._exploration.standard_normal(self._low.size, dtype=np.float32)
