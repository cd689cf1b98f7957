"""Bodies of boxes and worlds for them, whose physics can be calculated by hand."""

from __future__ import annotations

import numpy as np

from tma_ray.embodiments import BodyType, Embodiment, Joint, LidarLayout, Part, Polygon
from tma_ray.physics import Rules
from tma_ray.terrain import Terrain
from tma_ray.terrain.stump_tracks import stump_tracks

RULES = Rules("parkour", LidarLayout.FULL, observes_medium=True)


def corners(width: float, height: float) -> np.ndarray:
    """Return the corners (4, 2) of a box around the origin, counter-clockwise."""
    return np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array([width, height]) / 2


def box(width: float, height: float, density: float = 1.0) -> Embodiment:
    """Return a body that is one box."""
    shape = Polygon(tuple(map(tuple, corners(width, height).tolist())))
    part = Part("box", shape, (0.0, 0.0), density=density, friction=0.5, head=True)
    return Embodiment("box", BodyType.AMPHIBIAN, height / 2 + 0.01, 0.0, True, (part,), ())


def two_boxes(limits: tuple[float, float] = (-1.0, 1.0)) -> Embodiment:
    """Return a body with a limb of 0.8 m x 0.2 m that hangs on a motor at its left end."""
    head, limb = (Polygon(tuple(map(tuple, corners(*size).tolist()))) for size in ((0.4, 0.4), (0.8, 0.2)))
    parts = (
        Part("head", head, (0.0, 0.0), density=1.0, friction=0.5, head=True),
        Part("limb", limb, (0.5, 0.0), density=1.0, friction=0.5),
    )
    joint = Joint("head", "limb", (0.1, 0.0), limits, motor_torque=5.0, motor_speed=4.0)
    return Embodiment("two boxes", BodyType.AMPHIBIAN, 1.0, 0.0, True, parts, (joint,))


def pool(depth: float, height: float, water_y: float = 0.0) -> Terrain:
    """Return an open world whose ground is `depth` m under `water_y`, with a start `height` m over it."""
    terrain = stump_tracks(np.array([0.0, 6.0], dtype=np.float32), np.random.default_rng(0))
    terrain = terrain._replace(solids=terrain.solids[:1], surface=terrain.surface[:1], ground_solids=1)
    ground = water_y - depth
    return terrain._replace(
        solids=np.array([[[-50.0, ground - 5], [150.0, ground - 5], [150.0, ground], [-50.0, ground]]]),
        surface=np.array([[-50.0, ground, 150.0, ground]]),
        spawn=np.array([5.0, water_y + height]),
        water_y=water_y,
    )
