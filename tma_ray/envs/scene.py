"""Content of frames and rendering options, importable without pygame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tma_ray.physics import Engine
from tma_ray.physics.kernels import NOTHING
from tma_ray.terrain import Terrain

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Scene:
    """Content of a frame."""

    poses: Floats  # x, y, angle of every part's frame (p, 3), in m and rad
    terrain: Terrain  # terrain of the world
    creepers: Floats  # poses of the creepers (c, 4): centre in m, cosine and sine of the angle
    grips: NDArray[np.bool_]  # True for sensors that touch an object, and for those that hold one (g, 2)
    lidars: Floats  # ends of the rays (r, 2), in m
    # kinds of objects hit by the rays (r,): -1 water, 1 a creeper, 0 anything else
    hits: NDArray[np.float32]
    dead: bool  # True if the body has been in the wrong medium for too long


def scene_of(engine: Engine, terrain: Terrain, observation: NDArray[np.float32]) -> Scene:
    """Return the current scene of `engine`, given its last `observation` (o,)."""
    poses, body = engine.state[:, :3], engine.arrays
    rays = len(body.rays)
    if body.observes_medium:
        distances, hits, dead = observation[-2 * rays : -rays], observation[-rays:], observation[5] > 0
    else:
        distances, hits, dead = observation[-rays:], np.zeros(rays, np.float32), False
    return Scene(
        poses=poses,
        terrain=terrain,
        creepers=engine.creeper_poses,
        grips=engine.grips != NOTHING,
        lidars=poses[body.head, :2] + distances[:, None] * body.rays,
        hits=hits,
        dead=bool(dead),
    )


@dataclass(frozen=True)
class RenderOptions:
    """Options for the frames that an environment draws.

    Attributes:
        lidars: True to draw the rays.
        smooth: True to scale frames down to their size; False for frames (800, 1200, 3) with rough edges, for
            callers that scale them.
    """

    lidars: bool = True
    smooth: bool = True
