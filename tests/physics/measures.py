"""Measurements of a simulated body that need no reference: penetration, joint drift, limit overshoot."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tma_ray.physics.rules import BodyArrays
from tma_ray.terrain import Terrain

Floats = NDArray[np.float64]


def world_points(pose: Floats, points: Floats) -> Floats:
    """Return `points` (n, 2) of a frame at `pose` (x, y, angle, ...) in world axes."""
    sine, cosine = np.sin(pose[2]), np.cos(pose[2])
    return pose[:2] + points @ np.array([[cosine, sine], [-sine, cosine]])


def joint_drift(state: Floats, body: BodyArrays) -> Floats:
    """Return how far each joint's two anchors are apart (j,), in m."""
    return np.array(
        [
            np.linalg.norm(world_points(state[a], pair[:1]) - world_points(state[b], pair[1:]))
            for (a, b), pair in zip(body.joint_parts, body.anchors, strict=True)
        ]
    )


def limit_overshoot(state: Floats, body: BodyArrays) -> Floats:
    """Return how far each joint is outside its limits (j,), in rad; 0 inside."""
    a, b = body.joint_parts.T
    angles = state[b, 2] - state[a, 2]
    return np.maximum(0, np.maximum(body.limits[:, 0] - angles, angles - body.limits[:, 1]))


def penetration(state: Floats, body: BodyArrays, terrain: Terrain) -> Floats:
    """Return how deep each part's corners are inside the terrain's upright boxes (p,), in m; 0 outside.

    Depth is the shortest way out to the top or a side.
    """
    left, right, top = terrain.solids[:, 0, 0], terrain.solids[:, 1, 0], terrain.solids[:, 2, 1]
    depths = np.zeros(len(state))
    for part, pose in enumerate(state):
        corners = body.vertices[body.first_vertex[part] : body.first_vertex[part + 1]]
        x, y = world_points(pose, corners).T[:, :, None]
        depths[part] = max(0.0, np.minimum(top - y, np.minimum(x - left, right - x)).max())
    return depths
