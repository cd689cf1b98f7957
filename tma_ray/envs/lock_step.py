"""Many environments of one kind, stepped at the same time; each may begin its next episode by itself."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import gymnasium
import numpy as np
from numpy.typing import NDArray

from tma_ray.commands.arguments import check_whole
from tma_ray.physics import Engine, EngineBatch, batch_engines
from tma_ray.tasks import Task


class Outcome(NamedTuple):
    """What a step of k environments gives.

    Attributes:
        observations: (k, o).
        rewards: (k,).
        terminated: which episodes ended in their worlds (k,).
        truncated: which episodes reached their longest length (k,).
    """

    observations: NDArray[np.float32]
    rewards: NDArray[np.float64]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]

    @property
    def over(self) -> NDArray[np.bool_]:
        """Which episodes are over (k,)."""
        return self.terminated | self.truncated


class LockStep(Protocol):
    """n environments of one kind."""

    def reset(
        self, rows: NDArray[np.int64], seeds: Sequence[int | None], tasks: Iterable[Task | None]
    ) -> tuple[NDArray[np.float32], Task]:
        """Begins an episode in those at `rows` (k,); the first call names all.

        Args:
            rows: which.
            seeds: that make their episodes repeatable (k,); None goes on with an environment's own stream.
            tasks: of the episodes, each (d,); None draws one.

        Returns:
            Observations (k, o) and tasks (k, d).
        """
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


def lock_step(environments: Sequence[gymnasium.Env[Any, Any]], threads: int = 1) -> LockStep:
    """Returns the fastest way to step `environments`, which are all of one kind, together.

    Args:
        environments: new environments.
        threads: number of threads that step them; the bits are the same.

    Raises:
        ValueError: more threads than environments, or several without the benchmark's engine.
    """
    check_whole("threads", threads, least=1)
    own = all(isinstance(environment, EngineEnvironment) for environment in environments)
    most = len(environments) if own else 1
    if threads > most:
        reason = "one for each world" if own else "these worlds do not have the benchmark's engine"
        raise ValueError(f"threads = {threads}: expected at most {most}, {reason}")
    return EngineLockStep(environments, threads) if own else SequentialLockStep(environments)


class SequentialLockStep:
    """Environments of any kind, stepped in turn; see `LockStep`."""

    def __init__(self, environments: Sequence[gymnasium.Env[Any, Any]]) -> None:
        self._environments = environments

    def reset(
        self, rows: NDArray[np.int64], seeds: Sequence[int | None], tasks: Iterable[Task | None]
    ) -> tuple[NDArray[np.float32], Task]:
        """Begins an episode in some; see `LockStep`."""
        given = list(tasks)
        resets = [
            self._environments[row].reset(seed=seed, options=None if task is None else {"task": task})
            for row, seed, task in zip(rows, seeds, given, strict=True)
        ]
        observations = np.stack([observation for observation, _ in resets]).astype(np.float32, copy=False)
        played = [
            task if task is not None else info["task"] for task, (_, info) in zip(given, resets, strict=True)
        ]
        return observations, np.stack(played)

    def step(self, rows: NDArray[np.int64], actions: NDArray[np.float32]) -> Outcome:
        """Takes one step in some; see `LockStep`."""
        steps = [self._environments[row].step(action) for row, action in zip(rows, actions, strict=True)]
        observations, rewards, terminated, truncated, _ = zip(*steps, strict=True)
        return Outcome(
            np.stack(observations).astype(np.float32, copy=False),
            np.array(rewards, dtype=np.float64),
            np.array(terminated, dtype=np.bool_),
            np.array(truncated, dtype=np.bool_),
        )


class EngineLockStep(SequentialLockStep):
    """Environments that hand their engines over, each with a counter of its steps; see `LockStep`."""

    def __init__(self, environments: Sequence[gymnasium.Env[Any, Any]], threads: int = 1) -> None:
        super().__init__(environments)
        self._threads = threads
        self._batch: EngineBatch | None = None
        self._steps = np.zeros(len(environments), dtype=np.int64)
        self._longest = environments[0].max_episode_steps  # type: ignore[attr-defined]

    def reset(
        self, rows: NDArray[np.int64], seeds: Sequence[int | None], tasks: Iterable[Task | None]
    ) -> tuple[NDArray[np.float32], Task]:
        """Begins an episode in some; see `LockStep`."""
        observations, played = super().reset(rows, seeds, tasks)
        engines = [self._environments[row].release_engine() for row in rows]
        if self._batch is None:
            self._batch = batch_engines(engines, self._threads)
        self._steps[rows] = 0
        return observations, played

    def step(self, rows: NDArray[np.int64], actions: NDArray[np.float32]) -> Outcome:
        """Takes one step in some; see `LockStep`."""
        assert self._batch is not None, "reset begins the first episodes"
        observations, rewards, terminated = self._batch.step(rows, actions)
        self._steps[rows] = steps = self._steps[rows] + 1
        return Outcome(observations, rewards, terminated, ~terminated & (steps >= self._longest))
