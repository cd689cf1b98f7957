"""A student on the test set: all tasks in lock-step, one forward pass for those still running."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import gymnasium
import numpy as np
from numpy.typing import NDArray

from tma_ray.envs import make_environment
from tma_ray.envs.lock_step import LockStep, lock_step
from tma_ray.runs.inputs import arguments
from tma_ray.runs.spec import RunSpec
from tma_ray.runs.streams import evaluation_seeds
from tma_ray.tasks import Task

Environment = gymnasium.Env[Any, Any]

Act = Callable[[NDArray[np.float32]], NDArray[np.float32]]
"""Actions (n, a) for observations (n, o)."""


class GreedyPolicy(Protocol):
    """Something that acts without exploration."""

    def act_greedily(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """Returns deterministic actions (n, a) for observations (n, o)."""


def played_episodes(
    worlds: LockStep, seeds: Sequence[int], tasks: Task, act: Act, most_steps: float = math.inf
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Plays one episode of each task, all at the same time.

    Args:
        worlds: of which the first n are played in.
        seeds: of the n worlds.
        tasks: of the worlds (n, d).
        act: chooses the actions.
        most_steps: after which playing stops, over all worlds.

    Returns:
        Episodic returns and lengths (n,) so far; episodes that `most_steps` cut are not over.
    """
    running = np.arange(len(tasks))
    observations, _ = worlds.reset(running, seeds, tasks)
    episodic_returns = np.zeros(len(running))
    lengths = np.zeros(len(running), dtype=np.int64)
    while len(running) and most_steps > 0:
        outcome = worlds.step(running, act(observations))
        episodic_returns[running] += outcome.rewards
        lengths[running] += 1
        most_steps -= len(running)
        running, observations = running[~outcome.over], outcome.observations[~outcome.over]
    return episodic_returns, lengths


class Evaluation:
    """The worlds of a run's test set, built once and reset for every evaluation.

    Each world's randomness depends on the test set and the task's index alone (unlike the original
    release, whose test worlds differ from one evaluation to the next).
    """

    def __init__(self, spec: RunSpec, make: Callable[..., Environment] = make_environment) -> None:
        self.test_set = spec.test_set
        self._seeds = evaluation_seeds(spec.test_set)
        options = arguments(spec, "environment")
        self._environments = [make(spec.environment, **options) for _ in range(len(spec.test_set))]
        self._worlds = lock_step(self._environments)

    def __call__(self, policy: GreedyPolicy) -> list[dict[str, Any]]:
        """Plays one episode of every test task.

        Returns:
            Rows of the table of evaluations, without run and step.
        """
        episodic_returns, lengths = played_episodes(
            self._worlds, self._seeds, self.test_set.tasks, policy.act_greedily
        )
        outcomes = zip(episodic_returns, lengths, strict=True)
        return [self._row(index, *outcome) for index, outcome in enumerate(outcomes)]

    def close(self) -> None:
        """Closes all worlds."""
        for environment in self._environments:
            environment.close()

    def _row(self, index: int, episodic_return: float, length: int) -> dict[str, Any]:
        return {
            "test_set": self.test_set.name,
            "task_index": index,
            "task": self.test_set.tasks[index],
            "episodic_return": float(episodic_return),
            "length": int(length),
        }
