"""Choice of the engine: the compiled one where it works, else pymunk's. The results are the same bits."""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from tma_ray.embodiments import Embodiment, LidarLayout, load_embodiment
from tma_ray.physics.base import Engine, SolverSettings
from tma_ray.physics.rules import Rules, observation_size

if TYPE_CHECKING:
    from tma_ray.physics.compiled.engine import CompiledEngine
    from tma_ray.physics.pymunk_engine import PymunkEngine


logger = logging.getLogger(__name__)

VARIABLE = "TMA_RAY_ENGINE"
"""Environment variable that demands an engine: "compiled" (an error where it does not work) or "pymunk"."""

TRIAL_STEPS = 40
"""Steps that both engines must agree on before the compiled one is trusted."""


@dataclass(frozen=True)
class EngineChoice:
    """The engine of this process.

    Attributes:
        name: "compiled" or "pymunk".
        reason: why this one, as a sentence without a full stop.
    """

    name: str
    reason: str


def make_engine(body: Embodiment, rules: Rules, settings: SolverSettings | None = None) -> Engine:
    """Return a new engine of the kind that `engine_in_use` names.

    Args:
        body: the body.
        rules: the environment's rules for the body.
        settings: settings of Chipmunk's solver; None for the usual ones with the body's substeps.

    Raises:
        ValueError: TMA_RAY_ENGINE is neither "compiled" nor "pymunk".
        RuntimeError: TMA_RAY_ENGINE demands the compiled engine, which does not work here.
    """
    return _engine_class(engine_in_use().name)(body, rules, settings)


@cache
def engine_in_use() -> EngineChoice:
    """Return the engine of this process and the reason; the choice is made, and logged, once.

    Raises:
        ValueError: TMA_RAY_ENGINE is neither "compiled" nor "pymunk".
        RuntimeError: TMA_RAY_ENGINE demands the compiled engine, which does not work here.
    """
    demanded = os.environ.get(VARIABLE, "")
    if demanded not in ("", "compiled", "pymunk"):
        raise ValueError(f"{VARIABLE}={demanded}: expected 'compiled' or 'pymunk', or unset for the fastest")
    if demanded == "pymunk":
        return EngineChoice("pymunk", f"{VARIABLE}=pymunk demands it")
    try:
        _try_compiled()
    except Exception as error:
        if demanded:
            raise RuntimeError(f"{VARIABLE}=compiled, but the compiled engine fails: {error}") from error
        logger.warning("Simulating with pymunk, several times slower: the compiled engine fails: %s", error)
        return EngineChoice("pymunk", f"the compiled engine fails: {error}")
    return EngineChoice("compiled", "it works and gives the same bits as pymunk")


def _engine_class(name: str) -> type[CompiledEngine | PymunkEngine]:
    if name == "compiled":
        from tma_ray.physics.compiled.engine import CompiledEngine

        return CompiledEngine
    from tma_ray.physics.pymunk_engine import PymunkEngine

    return PymunkEngine


def _try_compiled() -> None:
    """Play with both engines.

    Raises:
        RuntimeError: they differ, or this machine has no known way to call Chipmunk.
    """
    from tma_ray.terrain.stump_tracks import stump_tracks  # here, since it loads numba

    body = load_embodiment("classic_bipedal")
    rules = Rules("stump_tracks", LidarLayout.DOWN, observes_medium=True)
    fast, oracle = (_engine_class(name)(body, rules) for name in ("compiled", "pymunk"))
    terrain = stump_tracks(np.array([1.0, 0.5], dtype=np.float32), np.random.default_rng(0))
    actions = np.random.default_rng(1).uniform(-1.0, 1.0, (TRIAL_STEPS, body.action_size))
    same = fast.reset(terrain, 3.0).tobytes() == oracle.reset(terrain, 3.0).tobytes()
    for action in actions:
        (seen, *outcome), (expected, *expected_outcome) = fast.step(action), oracle.step(action)
        same &= seen.tobytes() == expected.tobytes() and outcome == expected_outcome
        same &= fast.state.tobytes() == oracle.state.tobytes()
    if not same:
        raise RuntimeError("its trajectory is not pymunk's")


Outcome = tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.bool_]]
"""Observations (k, o), rewards (k,) and ends of episodes (k,) of k worlds."""


class EngineBatch(Protocol):
    """Engines of one body that have been reset; each may be reset again, into a new world."""

    def step(self, rows: NDArray[np.int64], actions: NDArray[np.float32]) -> Outcome:
        """Advance some worlds by TIME_STEP, with the same bits as their engines one by one.

        Args:
            rows: indices of the engines to step (k,).
            actions: actions of these engines (k, a), as `Engine.step` takes them.

        Raises:
            ValueError: actions of another shape, or not finite.
        """
        ...


def batch_engines(engines: Sequence[Engine], threads: int = 1) -> EngineBatch:
    """Return a batch of `engines`, all made by `make_engine` for one body and reset.

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
        """Advance some worlds; see `EngineBatch`."""
        outcomes = [self._engines[row].step(action) for row, action in zip(rows, actions, strict=True)]
        observations, rewards, ended = zip(*outcomes, strict=True)
        return np.stack(observations), np.array(rewards), np.array(ended)


class CompiledBatch:
    """A batch of compiled engines, stepped by compiled loops in `threads` threads; see `EngineBatch`."""

    def __init__(self, engines: Sequence[CompiledEngine], threads: int = 1) -> None:
        from tma_ray.physics.compiled.engine import WorldThreads  # here, since it loads numba

        self._threads = WorldThreads(threads)
        self._engines = engines  # whose memories must live as long as their addresses are used
        self._addresses = np.array([engine.addresses for engine in engines], dtype=np.int64)
        body = engines[0].arrays
        self._observation_size, self._action_size = observation_size(body), len(body.motors) + len(body.grips)

    def step(self, rows: NDArray[np.int64], actions: NDArray[np.float32]) -> Outcome:
        """Advance some worlds; see `EngineBatch`."""
        expected = len(rows), self._action_size
        if actions.shape != expected:
            raise ValueError(f"actions of {len(rows)} worlds have shape {expected}, got {actions.shape}")
        observations = np.empty((len(rows), self._observation_size), np.float32)
        rewards, ended = np.empty(len(rows)), np.empty(len(rows), np.bool_)
        self._threads.step(self._addresses[rows], actions, observations, rewards, ended)
        if np.count_nonzero(np.isnan(rewards)):
            raise ValueError(f"actions must be finite, got {actions[np.isnan(rewards)][0].tolist()}")
        return observations, rewards, ended
