"""Content and options of frames, independent of pygame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tma_ray.physics import Engine
from tma_ray.physics.kernels import NOTHING
from tma_ray.terrain import Terrain

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Scene:
    """Everything that a frame shows."""

    poses: Floats  # x, y, angle of every part's frame (p, 3), in m and rad
    terrain: Terrain  # terrain of the world
    creepers: Floats  # each creeper's centre in m, cosine and sine of its angle (c, 4)
    grips: NDArray[np.bool_]  # True for grip sensors that touch, and that hold, an object (g, 2)
    lidars: Floats  # ends of the rays (r, 2), in m
    # kind of object that each ray hits (r,): -1 water, 1 a creeper, 0 anything else
    hits: NDArray[np.float32]
    dead: bool  # True if the body has been in the wrong medium for too long


def scene_of(engine: Engine, terrain: Terrain, observation: NDArray[np.float32]) -> Scene:
    """Return the scene of `engine`, which last returned `observation` (o,)."""
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
    """Options of the frames that an environment draws.

    Attributes:
        lidars: True to draw the rays.
        smooth: True to scale frames down to their size; False for frames (800, 1200, 3) with rough edges, for
            callers that scale them.
    """

    lidars: bool = True
    smooth: bool = True
