"""Contents of the page: bodies, worlds and constants, as the engine's memory has them."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tma_ray.embodiments import Embodiment, embodiment_names, load_embodiment
from tma_ray.envs.body_environment import MAX_EPISODE_STEPS, PUSH
from tma_ray.envs.catalogue import ENVIRONMENTS
from tma_ray.physics import observation_size, step_arrays
from tma_ray.physics.chipmunk import hung, settled
from tma_ray.physics.compiled import memory
from tma_ray.physics.creepers import Chains
from tma_ray.physics.engine import GRAVITY, HANGING_STEPS, TIME_STEP, settings_for
from tma_ray.physics.grips import NOTHING
from tma_ray.tasks import MASTERY_RETURN, TaskSpace
from tma_ray.terrain import parkour, stump_tracks
from tma_ray.terrain.cppn import CPPN, SHAPES
from tma_ray.terrain.terrain import FIXED, GROUND_HEIGHT, STARTPAD_STEPS, STEP, Terrain

KINDS: Final = {"float64": "double", "float32": "float", "int64": "i64", "bool": "bool"}
"""The page's names for types of numbers."""

WHOLE: Final = ("contacts", "medium", "wet", "grips", "handles", "holds")
"""Parts of a simulation that are whole numbers."""

SIZES: Final = (0.6, 0.8, 1.25, 1.6)
"""Factors of a body's lengths that the page offers beside its own size."""


def stored(values: NDArray[Any]) -> list[Any]:
    """Returns an array as the page takes it: its kind, its sizes and its values one after the other."""
    return [KINDS[values.dtype.name], list(values.shape), values.ravel().tolist()]


def body_record(body: Embodiment, environment: str) -> dict[str, Any]:
    """Returns everything that the page's engine needs of `body` in an environment."""
    made = ENVIRONMENTS.get(environment)(embodiment=body)
    rules, settings = made.rules, settings_for(body)
    arrays, built = step_arrays(body, rules), settled(body, settings)
    floats, integers = vectors = memory.new_memory(arrays, len(built.limits), settings, 0)
    parts = memory.simulation_in(*vectors)._asdict()
    views = {
        name: [_place(part, integers if name in WHOLE else floats), list(part.shape)] for name, part in parts.items()
    }
    return {
        "built": [stored(value) if isinstance(value, np.ndarray) else value for value in built],
        "floats": ["double", len(floats), np.trim_zeros(floats, "b").tolist()],
        "integers": ["i64", len(integers), integers.tolist()],
        "views": views,
        "whole": list(WHOLE),
        "settings": list(settings),
        "observation": observation_size(arrays),
        "head": arrays.head,
        "motors": len(arrays.motors),
        "grips": len(arrays.grips),
        "parts": len(arrays.critical),
        "reach": _reach(body, environment) if len(arrays.grips) else 0.0,
        "rays": arrays.rays.tolist(),
        "sensors": [[int(part), *place] for part, place in zip(arrays.grip_part, arrays.grips.tolist(), strict=True)],
    }


def _place(part: NDArray[Any], vector: NDArray[Any]) -> int:
    return (part.ctypes.data - vector.ctypes.data) // 8 if part.size else 0


def _reach(body: Embodiment, environment: str) -> float:
    """Returns how high over its spawn point a hanging body's highest grip sensor is, in m."""
    rules = ENVIRONMENTS.get(environment)(embodiment=body).rules
    nothing = np.zeros((0, 4))
    flat = np.array([[-1.0, 0.0, 1.0, 0.0]])
    terrain = Terrain(nothing, 1.0, nothing, np.zeros(2), 0.0, 0, flat, nothing, np.zeros(0, np.int64), 0.0)
    return -float(hung(terrain, settled(body, settings_for(body)), step_arrays(body, rules)).spawn[1])


def variants(name: str) -> list[str]:
    """Returns the names of a body in all sizes that the page offers, its own first."""
    return [name, *(f"{name}:size={size}" for size in SIZES)]


def bodies(names: list[str] | None = None) -> dict[str, Any]:
    """Returns records of bodies by name and environment; all shipped ones in their own size if none are named."""
    chosen = embodiment_names() if names is None else names
    return {
        name: {environment: body_record(load_embodiment(name), environment) for environment in ("stump_tracks", "parkour")}
        for name in chosen
    }


def constants() -> dict[str, Any]:
    """Returns numbers of the physics, of the episodes and of the worlds."""
    own = {
        name: getattr(memory, name) for name in ("BEFORE", "GOAL_X", "TERRAIN")
    }
    stumps = {name: getattr(stump_tracks, name) for name in ("TRACK_LENGTH", "FIRST_STUMP", "STUMP_WIDTH")}
    return {
        **own,
        **stumps,
        "NOTHING": NOTHING,
        "FIXED": FIXED,
        "GRAVITY": GRAVITY,
        "TIME_STEP": TIME_STEP,
        "HANGING_STEPS": HANGING_STEPS,
        "MAX_EPISODE_STEPS": MAX_EPISODE_STEPS,
        "MASTERY_RETURN": MASTERY_RETURN,
        "PUSH": PUSH,
        "STEP": STEP,
        "GROUND_HEIGHT": GROUND_HEIGHT,
        "STARTPAD_STEPS": STARTPAD_STEPS,
    }
