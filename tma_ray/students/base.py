"""Base class of students, and the types of their inputs and outputs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from gymnasium import Space, spaces
    from torch import nn


Observations: TypeAlias = NDArray[np.float32]  # a raw observation (o,) or several (n, o), never normalised

Actions: TypeAlias = NDArray[np.float32]  # an action (a,) or several (n, a), within the action space

Policy: TypeAlias = Callable[[Observations], Actions]
"""Greedy policy of a trained student: observations (n, o) to deterministic actions (n, a)."""


class Transition(NamedTuple):
    """One environment step, as passed to `Student.observe`.

    Attributes:
        observation: observation before the step (o,).
        action: action of the student (a,).
        reward: raw reward of the environment.
        next_observation: observation after the step (o,); the last one of the episode if it ended.
        terminated: True if the episode ended in a terminal state.
        truncated: True if a time limit ended the episode; targets then bootstrap from `next_observation`.
    """

    observation: Observations
    action: Actions
    reward: float
    next_observation: Observations
    terminated: bool
    truncated: bool


class Student(ABC):
    """Base class of students, deep-RL algorithms with their networks and experience buffer.

    For every step the run calls `act`, steps the environment, and calls `observe`; the transitions of
    an episode arrive in order. The run constructs a plug-in as
    ``Student(observation_space, action_space, hyperparameters, seed, device, threads)``.

    Attributes:
        algorithm_version: version in the identity of every run, increased with each change of behaviour; None
            for plug-ins identified by their source alone.
        hyperparameters_type: frozen dataclass of the hyper-parameters.
        gamma: discount factor.
    """

    algorithm_version: ClassVar[int | None] = None
    hyperparameters_type: type
    gamma: float

    @abstractmethod
    def act(self, observation: Observations) -> Actions:
        """Return an exploring action (a,) for `observation` (o,)."""

    @abstractmethod
    def observe(self, transition: Transition) -> None:
        """Store the `transition` that followed the last `act`, and perform any updates due."""

    @abstractmethod
    def act_greedily(self, observations: Observations) -> Actions:
        """Return deterministic actions (n, a) for `observations` (n, o), without changing any state."""

    def sample_actions(self, observations: Observations, rng: np.random.Generator) -> Actions:
        """Return exploring actions (n, a) for `observations` (n, o), without changing any state.

        The actions are distributed like those of `act`, with noise from `rng`. Teachers that declare
        `wants_evaluations` need it.
        """
        raise NotImplementedError(f"student {type(self).__name__} does not define sample_actions")

    @abstractmethod
    def state_values(self, observations: Observations) -> NDArray[np.float64]:
        """Return V(s) (n,) of `observations` (n, o) under the exploring policy.

        Values are discounted returns of raw rewards, plus the bonuses of `entropy_bonuses`. Training is not
        affected.
        """

    def entropy_bonuses(self, observations: Observations) -> NDArray[np.float64]:
        """Return the expected entropy bonuses (n,) at `observations` (n, o); zeros by default.

        Scores that compare values with rewards add them to the rewards.
        """
        return np.zeros(len(observations))

    @abstractmethod
    def reset(self) -> None:
        """Reinitialise the networks and optimisers, and discard all stored experience.

        Called between `observe` and `act`, also within an episode, which goes on. Normalising statistics
        stay, and the initial exploration is not repeated (both as in the original release).
        """

    @abstractmethod
    def save(self, folder: Path, incremental: bool = False) -> tuple[str, ...]:
        """Write a checkpoint to `folder`, and return the names of unchanged files left out.

        Training resumes bit for bit from the checkpoint. Called at the end of an episode.

        Args:
            folder: an existing, empty folder of the student alone.
            incremental: True if the files last saved or loaded still exist, so that unchanged large files may
                be left out.

        Returns:
            The names of the files left out, which a later `load` finds in its folder.
        """

    @abstractmethod
    def load(self, folder: Path) -> None:
        """Load a state written by `save` of a student constructed with the same arguments.

        Raises:
            ValueError: if the state is of another algorithm or of other hyper-parameters.
        """

    @abstractmethod
    def save_policy(self, folder: Path) -> None:
        """Write the greedy policy to the existing `folder`, without pickle, which is unsafe to load.

        `tma_ray.students.write_policy` writes arrays and settings.
        """

    @classmethod
    @abstractmethod
    def load_policy(cls, folder: Path, device: str = "cpu") -> Policy:
        """Return the greedy policy written by `save_policy`.

        The folder may come from anywhere: read it with `tma_ray.students.read_policy`, which runs nothing.

        Raises:
            PolicyFileError: if a file was not written by `save_policy`.
        """

    @classmethod
    def policy_layers(cls, folder: Path) -> nn.Sequential:  # noqa: ARG003
        """Return the layers of the greedy policy in `folder`, mapping observations (n, o) to actions (n, a).

        Exports to other formats support torch's layers and those of `tma_ray.students.layers`.

        Raises:
            PolicyFileError: errors of `load_policy`.
            ValueError: if the policy is not a sequence of layers.
        """
        raise ValueError(
            f"student {cls.__name__} does not define policy_layers, which tells what it computes"
        )


def checked_spaces(observation_space: Space[Any], action_space: Space[Any]) -> tuple[spaces.Box, spaces.Box]:
    """Check that both spaces are one-dimensional float32 boxes and actions are bounded; return them."""
    boxes = _checked_box(observation_space, "observation"), _checked_box(action_space, "action")
    if not boxes[1].is_bounded():
        raise ValueError(f"action space {boxes[1]}: expected finite bounds")
    return boxes


def _checked_box(space: Space[Any], kind: str) -> spaces.Box:
    from gymnasium import spaces  # deferred, so that listing students does not import it

    if not isinstance(space, spaces.Box) or len(space.shape) != 1 or space.dtype != np.float32:
        raise ValueError(f"{kind} space {space}: expected a one-dimensional float32 Box")
    return space


class StudentStreams(NamedTuple):
    """Independent seeds of a student, one per purpose, spawned in the order of the fields."""

    networks: np.random.SeedSequence  # for initial weights and actions sampled in updates
    exploration: np.random.SeedSequence
    batches: np.random.SeedSequence
    values: np.random.SeedSequence

    @classmethod
    def of(cls, seed: np.random.SeedSequence) -> StudentStreams:
        """Spawn one seed per purpose from `seed`, without changing it."""
        return cls(*_children(seed, len(cls._fields)))


def update_key(seed: np.random.SeedSequence) -> int:
    """Return the 64-bit key for the random numbers of a student's updates in a cohort."""
    index = len(StudentStreams._fields)
    return int(_children(seed, index + 1)[index].generate_state(1, np.uint64)[0])


def _children(seed: np.random.SeedSequence, count: int) -> list[np.random.SeedSequence]:
    return [np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, k)) for k in range(count)]
