"""The contract between a student and the run that drives it."""

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


Observations: TypeAlias = NDArray[np.float32]
"""One observation (o,) or several (n, o), as the environment gave them: never normalised."""

Actions: TypeAlias = NDArray[np.float32]  # one action (a,) or several (n, a), inside the action space

Policy: TypeAlias = Callable[[Observations], Actions]
"""What remains of a trained student: observations (n, o) to deterministic actions (n, a)."""


class Transition(NamedTuple):
    """One step of training.

    Attributes:
        observation: observation that the student acted on (o,).
        action: action of the student (a,).
        reward: the environment's own reward.
        next_observation: observation after the step (o,); the last one of the episode if it ended.
        terminated: the episode ended by itself; nothing follows.
        truncated: the episode was cut (time limit): the value of `next_observation` still counts.
    """

    observation: Observations
    action: Actions
    reward: float
    next_observation: Observations
    terminated: bool
    truncated: bool


class Student(ABC):
    """A deep-RL algorithm with its networks and its buffer, stepped by the run.

    For every step the run calls `act`, steps the environment, and calls `observe`; the transitions of
    an episode arrive in order. A student registered by someone else is constructed as
    ``Student(observation_space, action_space, hyperparameters, seed, device, threads)`` and names the
    frozen dataclass of its hyper-parameters in `hyperparameters_type`.

    Attributes:
        algorithm_version: part of the identity of every run: raised with each change that gives other
            actions. None for a plug-in that is told apart by its source alone.
        hyperparameters_type: frozen dataclass that the constructor takes.
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
        """Store the step that followed the last `act`, and update the networks when that is due."""

    @abstractmethod
    def act_greedily(self, observations: Observations) -> Actions:
        """Return the policy's deterministic actions (n, a) for `observations` (n, o); change no state."""

    def sample_actions(self, observations: Observations, rng: np.random.Generator) -> Actions:
        """Return actions (n, a) of the exploring policy for `observations` (n, o); change no state.

        They have the distribution of what `act` returns, but their noise is drawn from `rng`, and nothing is
        counted. A student that defines this can play episodes from which it does not learn, for teachers that
        declare `wants_evaluations`.
        """
        raise NotImplementedError(f"student {type(self).__name__} does not define sample_actions")

    @abstractmethod
    def state_values(self, observations: Observations) -> NDArray[np.float64]:
        """Return V(s) (n,) of `observations` (n, o) under the exploring policy.

        The unit is the discounted return of the environment's own rewards, whatever the student
        normalises, plus the bonuses of `entropy_bonuses`. Training goes on as if it had not been asked.
        """

    def entropy_bonuses(self, observations: Observations) -> NDArray[np.float64]:
        """Return the part of the values of `observations` (n, o) that is not reward.

        Scores that compare values with rewards add them to the rewards.

        Returns:
            Expected bonuses (n,): 0 unless the student's objective has the policy's entropy in it.
        """
        return np.zeros(len(observations))

    @abstractmethod
    def reset(self) -> None:
        """Forget everything learned: new networks, new optimisers, no stored experience.

        Called between `observe` and `act`, also within an episode, which goes on. What is fitted to
        the environment rather than learned stays: statistics that normalise observations and rewards;
        and the initial exploration is not repeated (both as in the original release).
        """

    @abstractmethod
    def save(self, folder: Path, incremental: bool = False) -> tuple[str, ...]:
        """Write the complete state into `folder`, so that training resumes bit for bit.

        Called at the end of an episode.

        Args:
            folder: an existing, empty folder of the student's own.
            incremental: True if what was last saved or loaded is still there: large files that did not change
                since may be left out.

        Returns:
            The names of the files that were left out; a later `load` finds them in its folder.
        """

    @abstractmethod
    def load(self, folder: Path) -> None:
        """Load the state that `save` wrote, from a student with the same construction.

        Raises:
            ValueError: the state belongs to a student of another kind or with other hyper-parameters.
        """

    @abstractmethod
    def save_policy(self, folder: Path) -> None:
        """Write what is needed to play the greedy policy into the existing `folder`.

        Others download it: no pickles. `tma_ray.students.write_policy` writes arrays and settings.
        """

    @classmethod
    @abstractmethod
    def load_policy(cls, folder: Path, device: str = "cpu") -> Policy:
        """Return the greedy policy that `save_policy` wrote.

        The folder may come from anywhere: nothing in it is unpickled or run.
        `tma_ray.students.read_policy` reads it so.

        Raises:
            PolicyFileError: a file that `save_policy` did not write.
        """

    @classmethod
    def policy_layers(cls, folder: Path) -> nn.Sequential:  # noqa: ARG003
        """Return the layers of the greedy policy in `folder`, from observations (n, o) to actions (n, a).

        Files in other formats are made of it. What is not a layer of torch, nor one of
        `tma_ray.students.layers`, cannot be expected to be known there. A student that says nothing
        is exported without them.

        Raises:
            PolicyFileError: errors of `load_policy`.
            ValueError: the policy is not a row of layers.
        """
        raise ValueError(
            f"student {cls.__name__} does not define policy_layers, which tells what it computes"
        )

    def scalars(self) -> dict[str, float]:
        """Return figures about the last update for logging (losses, ...), by name."""
        return {}


def checked_spaces(observation_space: Space[Any], action_space: Space[Any]) -> tuple[spaces.Box, spaces.Box]:
    """Return both spaces.

    Raises:
        ValueError: a space that is not a one-dimensional float32 box, or unbounded actions.
    """
    boxes = _checked_box(observation_space, "observation"), _checked_box(action_space, "action")
    if not boxes[1].is_bounded():
        raise ValueError(f"action space {boxes[1]}: expected finite bounds")
    return boxes


def _checked_box(space: Space[Any], kind: str) -> spaces.Box:
    from gymnasium import spaces  # here, since names of students need none of it

    if not isinstance(space, spaces.Box) or len(space.shape) != 1 or space.dtype != np.float32:
        raise ValueError(f"{kind} space {space}: expected a one-dimensional float32 Box")
    return space


class StudentStreams(NamedTuple):
    """Independent seeds for the parts of a student; the order of the fields is the order of spawning.

    Attributes:
        networks: initial weights, and actions sampled in updates.
        exploration: actions.
        batches: mini-batches.
        values: state values.
    """

    networks: np.random.SeedSequence
    exploration: np.random.SeedSequence
    batches: np.random.SeedSequence
    values: np.random.SeedSequence

    @classmethod
    def of(cls, seed: np.random.SeedSequence) -> StudentStreams:
        """Return the streams of the student with `seed`, which does not change."""
        return cls(*_children(seed, len(cls._fields)))


def update_key(seed: np.random.SeedSequence) -> int:
    """Return the 64-bit key of the draws of a student's updates in a cohort."""
    place = len(StudentStreams._fields)
    return int(_children(seed, place + 1)[place].generate_state(1, np.uint64)[0])


def _children(seed: np.random.SeedSequence, count: int) -> list[np.random.SeedSequence]:
    return [np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, k)) for k in range(count)]
