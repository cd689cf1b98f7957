"""Many environments, one episode each, all stepped at the same time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import gymnasium
import numpy as np
from numpy.typing import NDArray

from tma_ray.physics import Engine, EngineBatch, batch_engines
from tma_ray.tasks import Task

Outcome = tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.bool_]]
"""Observations (k, o), rewards (k,) and whether each episode is over (k,)."""


class LockStep(Protocol):
    """n environments of one kind."""

    def reset(self, seeds: Sequence[int], tasks: Task) -> NDArray[np.float32]:
        """Begins an episode in each: task (n, d) and seed (n,) decide it; returns observations (n, o)."""
        ...

    def step(self, rows: NDArray[np.int64], actions: NDArray[np.float32]) -> Outcome:
        """Takes one step in those at `rows` (k,), with `actions` (k, a); no episode that is over."""
        ...


@runtime_checkable
class EngineEnvironment(Protocol):
    """An environment whose steps are its engine's, so that many can be made in one call."""

    max_episode_steps: int

    def release_engine(self) -> Engine:
        """Returns the engine, for an episode that has begun and is played without the environment."""
        ...


def lock_step(environments: Sequence[gymnasium.Env[Any, Any]]) -> LockStep:
    """Returns the fastest way to step `environments`, which are all of one kind, together."""
    if all(isinstance(environment, EngineEnvironment) for environment in environments):
        return EngineLockStep(environments)
    return SequentialLockStep(environments)


class SequentialLockStep:
    """Environments of any kind, stepped in turn; see `LockStep`."""

    def __init__(self, environments: Sequence[gymnasium.Env[Any, Any]]) -> None:
        self._environments = environments

    def reset(self, seeds: Sequence[int], tasks: Task) -> NDArray[np.float32]:
        """Begins an episode in each; see `LockStep`."""
        observations = [
            environment.reset(seed=seed, options={"task": task})[0]
            for environment, seed, task in zip(self._environments, seeds, tasks, strict=True)
        ]
        return np.stack(observations).astype(np.float32, copy=False)

    def step(self, rows: NDArray[np.int64], actions: NDArray[np.float32]) -> Outcome:
        """Takes one step in some; see `LockStep`."""
        steps = [self._environments[row].step(action) for row, action in zip(rows, actions, strict=True)]
        observations, rewards, terminated, truncated, _ = zip(*steps, strict=True)
        return (
            np.stack(observations).astype(np.float32, copy=False),
            np.array(rewards, dtype=np.float64),
            np.array(terminated, dtype=np.bool_) | np.array(truncated, dtype=np.bool_),
        )


class EngineLockStep(SequentialLockStep):
    """Environments that hand their engines over; see `LockStep`."""

    def reset(self, seeds: Sequence[int], tasks: Task) -> NDArray[np.float32]:
        """Begins an episode in each; see `LockStep`."""
        observations = super().reset(seeds, tasks)
        engines = [environment.release_engine() for environment in self._environments]  # type: ignore[attr-defined]
        self._batch: EngineBatch = batch_engines(engines)
        self._steps_left = self._environments[0].max_episode_steps  # type: ignore[attr-defined]
        return observations

    def step(self, rows: NDArray[np.int64], actions: NDArray[np.float32]) -> Outcome:
        """Takes one step in some; see `LockStep`."""
        observations, rewards, ended = self._batch.step(rows, actions)
        self._steps_left -= 1
        return observations, rewards, ended | (self._steps_left <= 0)
