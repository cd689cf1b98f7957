"""Episodes of a curriculum: assigned tasks and reports of played episodes."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeAlias

import gymnasium
import numpy as np
from numpy.typing import NDArray

from tma_ray.tasks import EpisodeSoFar, Outcomes, Recorder, Task, TaskSpace, Trajectory

Environment: TypeAlias = gymnasium.Env[Any, Any]
Array: TypeAlias = NDArray[Any]

Apply: TypeAlias = Callable[[Any, Mapping[str, float]], object]
"""Function (environment, task by name) that prepares an environment for a task before its `reset`."""


@dataclass(frozen=True, eq=False)
class Assignment:
    """Task assigned to an episode."""

    number: int  # in the order of assignment
    task: Task  # (d,)
    trains: bool  # True if the student learns from the episode
    records: bool  # True if the teacher needs the trajectory


@dataclass(frozen=True, eq=False)
class PlayedEpisode:
    """Finished episode, with the fields of `tma_ray.tasks.Episode` and the number of its assignment."""

    number: int
    episodic_return: float
    discounted_return: float
    length: int
    initial_observation: Array
    trajectory: Trajectory | None


class Link(Protocol):
    """Connection of an environment to its curriculum, which may be in another process."""

    space: TaskSpace
    gamma: float
    mastery_return: float
    marks_withheld: bool

    def begin(self) -> Assignment:
        """Start the next episode and return its assignment."""

    def end(self, played: PlayedEpisode) -> None:
        """Report a finished episode."""

    def abandon(self, number: int) -> None:
        """Discard the episode `number` without reporting it."""

    def act(self, observations: Array) -> Array:
        """Return actions (n, a) of the exploring policy for observations (n, o)."""


@dataclass
class EpisodeUnderWay:
    """Totals of a running episode, and its trajectory if needed.

    Args:
        assignment: assignment of the episode.
        initial_observation: observation of `reset` (o,).
        gamma: the student's discount factor.
    """

    assignment: Assignment
    initial_observation: Array
    gamma: float
    _so_far: EpisodeSoFar = field(default_factory=EpisodeSoFar)
    _discounted_return: float = 0.0
    _discount: float = 1.0

    def __post_init__(self) -> None:
        self.initial_observation = np.array(self.initial_observation, dtype=np.float32)
        self._recorder = Recorder(self.initial_observation, self.gamma) if self.assignment.records else None

    @property
    def episodic_return(self) -> float:
        """Sum of the rewards so far."""
        return self._so_far.episodic_return

    def add(self, action: Any, reward: float, observation: Array, terminated: bool) -> None:
        """Add a step."""
        self._so_far.add(reward)
        self._discounted_return += self._discount * reward
        self._discount *= self.gamma
        if self._recorder is not None:
            self._recorder.add(np.atleast_1d(action), reward, np.array(observation), terminated)

    def played(self) -> PlayedEpisode:
        """Return the finished episode."""
        return PlayedEpisode(
            self.assignment.number,
            self._so_far.episodic_return,
            self._discounted_return,
            self._so_far.steps,
            self.initial_observation,
            None if self._recorder is None else self._recorder.trajectory(),
        )


def by_name(space: TaskSpace, task: Task) -> dict[str, float]:
    """Return a task (d,) as a dict from dimension names to values."""
    return dict(zip(space.names, map(float, task), strict=True))


def reset_to(
    environment: Environment, task: Mapping[str, float], apply: Apply | None, **kwargs: Any
) -> tuple[Any, dict[str, Any]]:
    """Reset `environment` to a task given by name, using `apply` or, if None, the option "task"."""
    if apply is not None:
        apply(environment, task)
        return environment.reset(**kwargs)
    options = {**(kwargs.pop("options", None) or {}), "task": np.array(list(task.values()), np.float32)}
    return environment.reset(options=options, **kwargs)


def next_assignment(
    environment: Environment, link: Link, apply: Apply | None, seed: int | None = None
) -> tuple[Assignment, int | None]:
    """Return the next assignment for the training loop, after playing any episodes without learning.

    Returns:
        The assignment, and the `seed` for the next `reset`, None if an episode has used it.
    """
    assignment = link.begin()
    while not (assignment.trains or link.marks_withheld):
        observation, _ = reset_to(environment, by_name(link.space, assignment.task), apply, seed=seed)
        episode, over, seed = EpisodeUnderWay(assignment, observation, link.gamma), False, None
        while not over:
            action = link.act(np.asarray(observation)[None])[0]
            observation, reward, terminated, truncated, _ = environment.step(action)
            episode.add(action, float(reward), observation, terminated)
            over = terminated or truncated
        link.end(episode.played())
        assignment = link.begin()
    return assignment, seed


class TaskEvaluation:
    """Evaluation of tasks in a copy of the training environment, for the argument `evaluate` of `Curriculum`.

    Args:
        make: function that returns a copy of the environment.
        act: function that returns actions (n, a) for observations (n, o).
        space: space of the tasks.
        mastery_return: episodic return over which a task is mastered.
        apply: function that prepares the environment for a task; see `Curriculum.wrap`.
        seed: seed of the first episode.
    """

    def __init__(
        self,
        make: Callable[[], Environment],
        act: Callable[[Array], Array],
        space: TaskSpace,
        mastery_return: float,
        *,
        apply: Apply | None = None,
        seed: int = 0,
    ) -> None:
        self._environment, self._act = make(), act
        self._space, self._mastery_return, self._apply = space, mastery_return, apply
        self._seed: int | None = seed

    def __call__(self, tasks: Task, greedy: bool) -> Outcomes:  # noqa: ARG002 - there is one policy
        """Play one episode of each task (n, d), and return the outcomes."""
        returns: NDArray[np.float64] = np.zeros(len(tasks))
        lengths = np.zeros(len(tasks), np.int64)
        for row, task in enumerate(tasks):
            named = by_name(self._space, task)
            observation, _ = reset_to(self._environment, named, self._apply, seed=self._seed)
            self._seed, over = None, False
            while not over:
                action = self._act(np.asarray(observation)[None])[0]
                observation, reward, terminated, truncated, _ = self._environment.step(action)
                returns[row] += float(reward)
                lengths[row] += 1
                over = terminated or truncated
        return Outcomes(returns, returns > self._mastery_return, lengths)
