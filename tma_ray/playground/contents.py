"""Data for the playground's page: bodies, task spaces and constants."""

from collections.abc import Iterable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tma_ray.embodiments import Embodiment, load_embodiment
from tma_ray.envs import make_environment
from tma_ray.envs.base import MAX_EPISODE_STEPS, PUSH
from tma_ray.physics import observation_size, step_arrays
from tma_ray.physics.base import GRAVITY, HANGING_STEPS, TIME_STEP, settings_for
from tma_ray.physics.chipmunk import hung, settled
from tma_ray.physics.compiled.step import BEFORE, GOAL_X, TERRAIN, new_memory, simulation_in
from tma_ray.physics.kernels import NOTHING
from tma_ray.tasks import MASTERY_RETURN, TaskSpace
from tma_ray.terrain import FIXED, GROUND_HEIGHT, Terrain, parkour, stump_tracks
from tma_ray.terrain.parkour import CPPN, SHAPES
from tma_ray.terrain.terrain import STARTPAD_STEPS, TERRAIN_STEP

C_TYPES: Final = {"float64": "double", "float32": "float", "int64": "i64", "bool": "bool"}
INTEGER_VIEWS: Final = ("contacts", "medium", "wet", "grips", "handles", "holds")
PLAYED: Final = ("stump_tracks", "parkour")  # environments on the page
BODY_SIZES: Final = (0.6, 0.8, 1.25, 1.6)  # factors by which bodies can be resized, besides 1


def stored(values: NDArray[Any]) -> list[Any]:
    """Return the C type, the shape and the flattened values of an array."""
    return [C_TYPES[values.dtype.name], list(values.shape), values.ravel().tolist()]


def body_record(body: Embodiment, environment: str) -> dict[str, Any]:
    """Return the data of `body` in an environment for the page's engine."""
    made: Any = make_environment(environment, embodiment=body)
    settings = settings_for(body)
    arrays, built = step_arrays(body, made.rules), settled(body, settings)
    floats, integers = vectors = new_memory(arrays, len(built.limits), settings, 0)
    views = {}
    for name, part in simulation_in(*vectors)._asdict().items():
        vector = integers if name in INTEGER_VIEWS else floats
        index = (part.ctypes.data - vector.ctypes.data) // 8 if part.size else 0
        views[name] = [index, list(part.shape)]
    reach = 0.0
    if len(arrays.grips):  # height of a hanging body's highest grip sensor above the spawn point, in m
        nothing, flat = np.zeros((0, 4)), np.array([[-1.0, 0.0, 1.0, 0.0]])
        world = Terrain(nothing, 1.0, nothing, np.zeros(2), 0.0, 0, flat, nothing, np.zeros(0, np.int64), 0.0)
        reach = -float(hung(world, built, arrays).spawn[1])
    return {
        "built": {
            name: stored(value) if isinstance(value, np.ndarray) else value
            for name, value in built._asdict().items()
        },
        "floats": ["double", len(floats), np.trim_zeros(floats, "b").tolist()],
        "integers": ["i64", len(integers), integers.tolist()],
        "views": views,
        "whole": list(INTEGER_VIEWS),
        "settings": list(settings),
        "observation": observation_size(arrays),
        "head": arrays.head,
        "motors": len(arrays.motors),
        "grips": len(arrays.grips),
        "parts": len(arrays.critical),
        "reach": reach,
        "rays": arrays.rays.tolist(),
        "sensors": [
            [int(part), *grip] for part, grip in zip(arrays.grip_part, arrays.grips.tolist(), strict=True)
        ],
    }


def variants(name: str) -> list[str]:
    """Return the names of a body in all sizes that the page offers, its own size first."""
    return [name, *(f"{name}:size={size}" for size in BODY_SIZES)]


def bodies(names: Iterable[str]) -> dict[str, Any]:
    """Return the records of the bodies `names`, by name and environment."""
    return {
        name: {environment: body_record(load_embodiment(name), environment) for environment in PLAYED}
        for name in names
    }


def constants() -> dict[str, dict[str, Any]]:
    """Return the constants of the engine, of episodes and of the terrain modules."""
    engine: dict[str, float] = {
        "BEFORE": BEFORE,
        "GOAL_X": GOAL_X,
        "TERRAIN": TERRAIN,
        "NOTHING": NOTHING,
        "FIXED": FIXED,
    }
    engine |= {"GRAVITY": GRAVITY, "TIME_STEP": TIME_STEP, "HANGING_STEPS": HANGING_STEPS, "PUSH": PUSH}
    engine |= {"MAX_EPISODE_STEPS": MAX_EPISODE_STEPS, "MASTERY_RETURN": MASTERY_RETURN}
    engine |= {"STEP": TERRAIN_STEP, "GROUND_HEIGHT": GROUND_HEIGHT, "STARTPAD_STEPS": STARTPAD_STEPS}
    worlds: dict[str, dict[str, Any]] = {
        module.__name__.rpartition(".")[2]: {
            name: value
            for name, value in vars(module).items()
            if name.isupper() and isinstance(value, int | float)
        }
        for module in (stump_tracks, parkour)
    }
    worlds["parkour"]["INSERTION_ORDER"] = parkour.INSERTION_ORDER.tolist()
    return {"engine": engine, **worlds}


def space_record(space: TaskSpace) -> list[dict[str, Any]]:
    """Return the dimensions of a task space as JSON values."""
    return [
        {"name": dimension.name, "low": dimension.low, "high": dimension.high, "unit": dimension.unit}
        for dimension in space.dimensions
    ]


def worlds() -> dict[str, Any]:
    """Return the task spaces by environment, and the weights of Parkour's network."""
    weights = [CPPN.load().weights[name] for name in SHAPES]
    return {
        "spaces": {
            name: space_record(make_environment(name).get_wrapper_attr("task_space")) for name in PLAYED
        },
        "cppn": [[list(matrix.shape), matrix.ravel()] for matrix in weights],
    }
