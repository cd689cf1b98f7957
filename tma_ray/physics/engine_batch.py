"""Batches of engines of one body, stepped in one call: no Python between them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from tma_ray.physics.engine import Engine
from tma_ray.physics.rules import observation_size
from tma_ray.physics.selection import engine_in_use

if TYPE_CHECKING:
    from tma_ray.physics.compiled.engine import CompiledEngine

Outcome = tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.bool_]]
"""Observations (k, o), rewards (k,) and ends of episodes (k,) of k worlds."""


class EngineBatch(Protocol):
    """Engines of one body that have been reset; each may be reset again, and goes on in its new world."""

    def step(self, rows: NDArray[np.int64], actions: NDArray[np.float32]) -> Outcome:
        """Advances some worlds by TIME_STEP, with the same bits as their engines one by one.

        Args:
            rows: which engines (k,).
            actions: theirs (k, a), as `Engine.step` takes them.

        Raises:
            ValueError: actions of another shape, or not finite.
        """
        ...


def batch_engines(engines: Sequence[Engine], threads: int = 1) -> EngineBatch:
    """Returns a batch of `engines`, all made by `make_engine` for one body and reset.

    Args:
        engines: engines of the worlds.
        threads: number of threads that step them; the bits are the same.

    Raises:
        ValueError: several threads, and this process uses the pymunk engine.
    """
    choice = engine_in_use()
    if choice.name == "compiled":
        return CompiledBatch(cast("Sequence[CompiledEngine]", engines), threads)
    if threads > 1:
        raise ValueError(f"threads = {threads}: expected 1 with the pymunk engine ({choice.reason})")
    return SequentialBatch(engines)


class SequentialBatch:
    """A batch of any engines, stepped one by one; see `EngineBatch`."""

    def __init__(self, engines: Sequence[Engine]) -> None:
        self._engines = engines

    def step(self, rows: NDArray[np.int64], actions: NDArray[np.float32]) -> Outcome:
        """Advances some worlds; see `EngineBatch`."""
        outcomes = [self._engines[row].step(action) for row, action in zip(rows, actions, strict=True)]
        observations, rewards, ended = zip(*outcomes, strict=True)
        return np.stack(observations), np.array(rewards), np.array(ended)


class CompiledBatch:
    """A batch of compiled engines, stepped by compiled loops in `threads` threads; see `EngineBatch`."""

    def __init__(self, engines: Sequence[CompiledEngine], threads: int = 1) -> None:
        from tma_ray.physics.compiled.threads import WorldThreads  # here, since it loads numba

        self._threads = WorldThreads(threads)
        self._engines = engines  # whose memories must live as long as their addresses are used
        self._addresses = np.array([engine.addresses for engine in engines], dtype=np.int64)
        body = engines[0].arrays
        self._observation_size, self._action_size = observation_size(body), len(body.motors) + len(body.grips)

    def step(self, rows: NDArray[np.int64], actions: NDArray[np.float32]) -> Outcome:
        """Advances some worlds; see `EngineBatch`."""
        expected = len(rows), self._action_size
        if actions.shape != expected:
            raise ValueError(f"actions of {len(rows)} worlds have shape {expected}, got {actions.shape}")
        observations = np.empty((len(rows), self._observation_size), np.float32)
        rewards, ended = np.empty(len(rows)), np.empty(len(rows), np.bool_)
        self._threads.step(self._addresses[rows], actions, observations, rewards, ended)
        if np.count_nonzero(np.isnan(rewards)):
            raise ValueError(f"actions must be finite, got {actions[np.isnan(rewards)][0].tolist()}")
        return observations, rewards, ended
