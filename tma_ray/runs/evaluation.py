"""Episodes without learning: evaluations on the test set, and episodes that a teacher requests."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from tma_ray.envs.vector import LockStep, lock_step
from tma_ray.runs.inputs import new_environment
from tma_ray.runs.spec import RunSpec, evaluation_seeds
from tma_ray.students import Student
from tma_ray.tasks import Outcomes, Task

Environment = gymnasium.Env[Any, Any]

Act = Callable[[NDArray[np.float32]], NDArray[np.float32]]  # maps observations (n, o) to actions (n, a)


def played_episodes(
    worlds: LockStep, seeds: Sequence[int], tasks: Task, act: Act, most_steps: float = math.inf
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Play one episode of each task in parallel, and return the episodic returns and lengths.

    Args:
        worlds: at least n worlds.
        seeds: seeds of the n worlds.
        tasks: tasks of the n worlds (n, d).
        act: policy.
        most_steps: largest total number of steps.

    Returns:
        Episodic returns and lengths (n,), partial for episodes cut short by `most_steps`.
    """
    running = np.arange(len(tasks))
    observations, _ = worlds.reset(running, seeds, tasks)
    lengths = np.zeros(len(running), dtype=np.int64)
    while len(running) and most_steps > 0:
        outcome = worlds.step(running, act(observations))
        lengths[running] += 1
        most_steps -= len(running)
        running, observations = running[~outcome.over], outcome.observations[~outcome.over]
    return worlds.episodic_returns[: len(tasks)].copy(), lengths


def new_worlds(spec: RunSpec, count: int) -> list[Environment]:
    """Return `count` new environments for a run."""
    return [new_environment(spec) for _ in range(count)]


class Evaluation:
    """Evaluation on a run's test set, in environments that are constructed once and reset each time.

    Each world's randomness depends only on the test set and the task's index, unlike in the original release,
    where test worlds differ between evaluations.
    """

    def __init__(self, spec: RunSpec) -> None:
        self.test_set = spec.test_set
        self._seeds = evaluation_seeds(spec.test_set)
        self._environments = new_worlds(spec, len(spec.test_set))
        self._worlds = lock_step(self._environments)

    def __call__(self, act: Act) -> list[dict[str, Any]]:
        """Evaluate a policy on all test tasks; return rows of `Table.EVALUATIONS` without run id and step."""
        episodic_returns, lengths = played_episodes(self._worlds, self._seeds, self.test_set.tasks, act)
        return [
            {
                "test_set": self.test_set.name,
                "task_index": index,
                "task": self.test_set.tasks[index],
                "episodic_return": float(episodic_return),
                "length": int(length),
            }
            for index, (episodic_return, length) in enumerate(zip(episodic_returns, lengths, strict=True))
        ]

    def close(self) -> None:
        """Close all environments."""
        for environment in self._environments:
            environment.close()


MAX_WORLDS = 64  # largest number of concurrent episodes of an evaluation


class UntrainedEpisodes:
    """Runner of the episodes without learning that a teacher requests, with its own random generator.

    Worlds and action noise are sampled anew for every evaluation; the generator is the only state.
    """

    def __init__(self, spec: RunSpec, seed: np.random.SeedSequence) -> None:
        self._spec = spec
        self._rng = np.random.default_rng(seed)
        self._environments: list[Environment] = []
        self._worlds: LockStep | None = None

    @property
    def state(self) -> dict[str, Any]:
        """State of the random generator."""
        return dict(self._rng.bit_generator.state)

    @state.setter
    def state(self, state: dict[str, Any]) -> None:
        self._rng.bit_generator.state = state

    def act(self, student: Student, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the exploring policy's action (a,) for an `observation` (o,)."""
        action: NDArray[np.float32] = student.sample_actions(observation[None], self._rng)[0]
        return action

    def evaluate(self, student: Student, tasks: Task, greedy: bool, budget: int) -> Outcomes | None:
        """Play one episode of each task without learning, and return the outcomes.

        Args:
            student: student that acts.
            tasks: tasks of the world (n, d).
            greedy: True for the deterministic policy instead of the exploring one.
            budget: number of steps left in the run.

        Returns:
            The outcomes, or None if the episodes exhaust the budget.
        """
        act = student.act_greedily if greedy else partial(student.sample_actions, rng=self._rng)
        seeds = self._rng.integers(2**31, size=len(tasks)).tolist()
        parts = []
        for first in range(0, len(tasks), MAX_WORLDS):
            rows = slice(first, first + MAX_WORLDS)
            if self._worlds is None or len(tasks[rows]) > len(self._environments):
                self.close()
                self._environments = new_worlds(self._spec, len(tasks[rows]))
                self._worlds = lock_step(self._environments)
            parts.append(played_episodes(self._worlds, seeds[rows], tasks[rows], act, budget))
            budget -= int(parts[-1][1].sum())
            if budget <= 0:
                return None
        episodic_returns, lengths = (np.concatenate(part) for part in zip(*parts, strict=True))
        return Outcomes(episodic_returns, episodic_returns > self._spec.mastery_threshold, lengths)

    def close(self) -> None:
        """Close all environments."""
        for environment in self._environments:
            environment.close()
