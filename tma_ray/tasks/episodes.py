"""Messages that a run and its teacher exchange: proposals, episodes, queries, answers and updates."""

import math
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from tma_ray.tasks.spaces import Task


@dataclass(frozen=True, eq=False)
class Proposal:
    """Task proposed for the next episode.

    Attributes:
        task: task in the task space, float32 (d,).
        trains: True if the student learns from the episode. Otherwise it plays its exploring policy without
            storing or updating anything; the steps count towards the budget nevertheless.
    """

    task: Task
    trains: bool = True


@dataclass
class EpisodeSoFar:
    """Running step count and return of an unfinished episode.

    Attributes:
        steps: number of steps so far.
        episodic_return: undiscounted sum of rewards so far.
    """

    steps: int = 0
    episodic_return: float = 0.0

    def add(self, reward: float) -> None:
        """Count a step and its reward."""
        self.steps += 1
        self.episodic_return += reward


def check_return(episodic_return: float, task: Task, episode: str) -> None:
    """Check that the return of an episode is finite.

    Raises:
        ValueError: if the return is infinite or NaN.
    """
    if not math.isfinite(episodic_return):
        raise ValueError(
            f"{episode}, on task {np.asarray(task).tolist()}, has the return {episodic_return}: expected a "
            f"finite number; check the rewards of the environment on this task, and that the student has not "
            f"diverged (a smaller learning rate helps)"
        )


@dataclass(frozen=True)
class Episode:
    """Finished training episode.

    Raises:
        ValueError: if its return is not finite.

    Attributes:
        task: task of the teacher, float32 (d,).
        episodic_return: undiscounted sum of the environment's rewards.
        success: True if `episodic_return` is over the mastery threshold.
        length: number of steps.
        initial_observation: observation of `reset`, float32 (o,).
        discounted_return: sum of rewards discounted by the student's gamma.
        step: environment steps of the run, including this episode.
        trains: True if the student learned from it, as in the `Proposal`.
    """

    task: Task
    episodic_return: float
    success: bool
    length: int
    initial_observation: NDArray[np.float32]
    discounted_return: float
    step: int
    trains: bool = True

    def __post_init__(self) -> None:
        episode = f"the episode of {self.length} steps that ended at step {self.step}"
        check_return(self.episodic_return, self.task, episode)


@dataclass(frozen=True)
class WeightedGaussian:
    """Component of a teacher's task distribution, a Gaussian with weight, mean (d,) and covariance (d, d)."""

    weight: float
    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]


@dataclass(frozen=True)
class ScoredBox:
    """Box in a teacher's task distribution, with lower and upper bounds (d,) and a score."""

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    score: float


@dataclass(frozen=True)
class TeacherUpdate:
    """State of a teacher after an update, as Gaussians, boxes and scalars for figures."""

    gaussians: tuple[WeightedGaussian, ...] = ()
    boxes: tuple[ScoredBox, ...] = ()
    scalars: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Steps of an episode of length t.

    Attributes:
        observations: raw observations, float32 (t + 1, o), from the initial one to that after the last step.
        actions: actions of the student, float32 (t, a).
        rewards: rewards of the environment, float64 (t,).
        terminated: True if the environment ended the episode; False after truncation, where targets
            bootstrap from the last observation.
        gamma: discount factor of the student's values.
        entropy_bonuses: bonuses, float64 (t,), that the student's values add to rewards, as in SAC; None
            without any.
    """

    observations: NDArray[np.float32]
    actions: NDArray[np.float32]
    rewards: NDArray[np.float64]
    terminated: bool
    gamma: float
    entropy_bonuses: NDArray[np.float64] | None = None


@dataclass(frozen=True, eq=False)
class Outcomes:
    """Outcomes of an evaluation on n tasks, with one episode per task.

    Attributes:
        episodic_returns: returns, float64 (n,).
        successes: True for returns over the mastery threshold (n,).
        lengths: numbers of steps, int64 (n,).
    """

    episodic_returns: NDArray[np.float64]
    successes: NDArray[np.bool_]
    lengths: NDArray[np.int64]


class QueryKind(StrEnum):
    """Kinds of queries that a teacher may make between `observe` and the next `sample`."""

    STATE_VALUES = "state_values"
    """Query for V(s) of observations under the current student, float64 (n,)."""

    TRAJECTORY = "trajectory"
    """Query for the `Trajectory` of the last episode, for teachers that declare `wants_trajectory`."""

    EVALUATION = "evaluation"
    """Query for the `Outcomes` of one episode of each task, without learning, for teachers that declare
    `wants_evaluations`. The steps count towards the budget; a run that ends first gives no answer."""


@dataclass(frozen=True)
class Query:
    """Query from a teacher to the run.

    Attributes:
        kind: kind of the query.
        observations: raw observations, float32 (n, o), for `STATE_VALUES` only.
        tasks: tasks in the task space, float32 (n, d), for `EVALUATION` only; repetitions are allowed.
        greedy: True if an evaluation plays the deterministic policy instead of the exploring one.
    """

    kind: QueryKind
    observations: NDArray[np.float32] | None = None
    tasks: Task | None = None
    greedy: bool = False

    def __post_init__(self) -> None:
        for name, kind, shape in (
            ("observations", QueryKind.STATE_VALUES, "(n, o)"),
            ("tasks", QueryKind.EVALUATION, "(n, d)"),
        ):
            is_given = getattr(self, name) is not None
            if is_given != (self.kind is kind):
                problem = f"takes no {name}" if is_given else f"needs {name} {shape}"
                raise ValueError(f"a query for {self.kind.value} {problem}")
        if self.greedy and self.kind is not QueryKind.EVALUATION:
            raise ValueError(f"a query for {self.kind.value} plays nothing: greedy is for evaluations")


Answer: TypeAlias = NDArray[np.float64] | Trajectory | Outcomes
"""Answer to a query, depending on its kind."""


class Recorder:
    """Recorder of an episode's trajectory.

    Args:
        initial_observation: observation of `reset` (o,).
        gamma: the student's discount factor.
    """

    def __init__(self, initial_observation: NDArray[np.float32], gamma: float) -> None:
        self._gamma = gamma
        self._observations = [initial_observation]
        self._actions: list[NDArray[np.float32]] = []
        self._rewards: list[float] = []
        self._terminated = False

    def add(
        self,
        action: NDArray[np.float32],
        reward: float,
        next_observation: NDArray[np.float32],
        terminated: bool,
    ) -> None:
        """Append a step."""
        self._observations.append(next_observation)
        self._actions.append(action.copy())  # copied, since a student may reuse its arrays
        self._rewards.append(reward)
        self._terminated = terminated

    def trajectory(self) -> Trajectory:
        """Return the trajectory so far, which must have at least one step."""
        return Trajectory(
            observations=np.stack(self._observations).astype(np.float32, copy=False),
            actions=np.stack(self._actions).astype(np.float32, copy=False),
            rewards=np.array(self._rewards, dtype=np.float64),
            terminated=self._terminated,
            gamma=self._gamma,
        )
