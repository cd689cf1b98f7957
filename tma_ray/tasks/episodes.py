"""Messages between a run and its teacher: proposals, episodes, queries and answers, logged updates."""

import math
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from tma_ray.tasks.spaces import Task


@dataclass(frozen=True, eq=False)
class Proposal:
    """A task for the next episode.

    Attributes:
        task: float32 (d,), inside the task space.
        trains: True if the student learns from the episode. If not, it plays its exploring policy and does
            not change: nothing is stored, counted or updated. The steps count to the budget all the same.
    """

    task: Task
    trains: bool = True


@dataclass
class EpisodeSoFar:
    """Totals of an episode under way.

    Attributes:
        steps: number of steps so far.
        episodic_return: undiscounted sum of their rewards.
    """

    steps: int = 0
    episodic_return: float = 0.0

    def add(self, reward: float) -> None:
        """Count a step and its reward."""
        self.steps += 1
        self.episodic_return += reward


def check_return(episodic_return: float, task: Task, episode: str) -> None:
    """Refuse an episodic return that is not a finite number: no teacher can learn from one.

    Args:
        episodic_return: return of an episode.
        task: task of the episode (d,).
        episode: the episode in words, for the message.

    Raises:
        ValueError: the return is infinite or NaN.
    """
    if not math.isfinite(episodic_return):
        raise ValueError(
            f"{episode}, on task {np.asarray(task).tolist()}, has the return {episodic_return}: expected a "
            f"finite number; check the rewards of the environment on this task, and that the student has not "
            f"diverged (a smaller learning rate helps)"
        )


@dataclass(frozen=True)
class Episode:
    """One finished training episode.

    Raises:
        ValueError: its return is not finite.

    Attributes:
        task: the task as the teacher chose it, float32 (d,).
        episodic_return: undiscounted sum of the environment's own rewards.
        success: True if `episodic_return` was over the mastery threshold.
        length: steps played.
        initial_observation: the observation that `reset` gave, float32 (o,).
        discounted_return: sum of rewards discounted by the student's gamma.
        step: environment steps of the run so far, this episode included.
        trains: True if the student learned from it, as the `Proposal` said.
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
    """A mixture component of a teacher's task distribution: weight, mean (d,), covariance (d, d)."""

    weight: float
    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]


@dataclass(frozen=True)
class ScoredBox:
    """A region of a teacher's task distribution: low (d,), high (d,), score."""

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    score: float


@dataclass(frozen=True)
class TeacherUpdate:
    """State of a teacher after an update, drawable for any teacher."""

    gaussians: tuple[WeightedGaussian, ...] = ()
    boxes: tuple[ScoredBox, ...] = ()
    scalars: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """All steps of one episode, t of them.

    Attributes:
        observations: float32 (t + 1, o), raw, from the initial one to the one after the last step.
        actions: float32 (t, a), as chosen by the student.
        rewards: float64 (t,), the environment's own.
        terminated: True if the environment ended the episode; else it was cut, and the value of the last
            observation still counts.
        gamma: the student's discount factor, by which it values states.
        entropy_bonuses: float64 (t,), what the student's values count in addition to rewards, as SAC's do;
            None for a student whose values count rewards only.
    """

    observations: NDArray[np.float32]
    actions: NDArray[np.float32]
    rewards: NDArray[np.float64]
    terminated: bool
    gamma: float
    entropy_bonuses: NDArray[np.float64] | None = None


@dataclass(frozen=True, eq=False)
class Outcomes:
    """Outcomes of the episodes of an evaluation, one of each of n tasks.

    Attributes:
        episodic_returns: float64 (n,).
        successes: bool (n,), whether each return was over the mastery threshold.
        lengths: int64 (n,), steps played.
    """

    episodic_returns: NDArray[np.float64]
    successes: NDArray[np.bool_]
    lengths: NDArray[np.int64]


class QueryKind(StrEnum):
    """Kinds of queries that a teacher may make between `observe` and the next `sample`."""

    STATE_VALUES = "state_values"
    """V(s) of observations under the current student: float64 (n,)."""

    TRAJECTORY = "trajectory"
    """The `Trajectory` of the episode just observed; for teachers that declare `wants_trajectory`."""

    EVALUATION = "evaluation"
    """The `Outcomes` of one episode of each task, from which the student does not learn; for teachers that
    declare `wants_evaluations`. Their steps count to the budget of the run, which may end in an
    evaluation: then it is not answered."""


@dataclass(frozen=True)
class Query:
    """A question from a teacher.

    Attributes:
        kind: kind of question.
        observations: float32 (n, o), raw as the environment gave them, for `STATE_VALUES` only.
        tasks: float32 (n, d), inside the task space, for `EVALUATION` only; a task may be named repeatedly.
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
            given, wanted = getattr(self, name) is not None, self.kind is kind
            if given != wanted:
                raise ValueError(
                    f"a query for {self.kind.value} "
                    + (f"takes no {name}" if given else f"needs {name} {shape}")
                )
        if self.greedy and self.kind is not QueryKind.EVALUATION:
            raise ValueError(f"a query for {self.kind.value} plays nothing: greedy is for evaluations")


Answer: TypeAlias = NDArray[np.float64] | Trajectory | Outcomes
"""What a query is answered with, depending on its kind."""
