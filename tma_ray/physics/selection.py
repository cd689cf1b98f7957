"""Choice of the engine: the compiled one where it works, otherwise pymunk, with the same results."""

from __future__ import annotations

import logging
import os
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from tma_ray.embodiments import Embodiment, LidarLayout, load_embodiment
from tma_ray.physics.base import Engine, SolverSettings
from tma_ray.physics.rules import Rules

if TYPE_CHECKING:
    from tma_ray.physics.compiled.engine import CompiledEngine
    from tma_ray.physics.pymunk_engine import PymunkEngine


logger = logging.getLogger(__name__)

VARIABLE = "TMA_RAY_ENGINE"  # environment variable that selects an engine: "compiled" or "pymunk"
TRIAL_STEPS = 40  # number of steps for which both engines are compared


@dataclass(frozen=True)
class EngineChoice:
    """Engine of this process, and the reason for its choice."""

    name: str  # "compiled" or "pymunk"
    reason: str  # reason for the choice, without a full stop


def make_engine(body: Embodiment, rules: Rules, settings: SolverSettings | None = None) -> Engine:
    """Return a new engine of the kind in use; `settings` default to those of `body`."""
    return _engine_class(engine_in_use().name)(body, rules, settings)


@cache
def engine_in_use() -> EngineChoice:
    """Return the engine that this process uses, chosen on the first call.

    Raises:
        ValueError: if TMA_RAY_ENGINE is neither "compiled" nor "pymunk".
        RuntimeError: if TMA_RAY_ENGINE forces the compiled engine, which does not work here.
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
    """Check that both engines compute the same short trajectory.

    Raises:
        RuntimeError: if the trajectories differ, or Chipmunk cannot be called on this machine.
    """
    from tma_ray.terrain.stump_tracks import stump_tracks  # deferred: loads numba

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
