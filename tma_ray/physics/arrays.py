"""A body as an engine builds it: plain arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tma_ray.embodiments import Embodiment, GripSensor, Joint, Part, Point


class BodyArrays(NamedTuple):
    """p parts and h joints, those with motors first, as an engine builds them.

    Attributes:
        mass: with the grip sensors that are welded to a part (p,), in kg.
        inertia: about the centre of mass (p,), in kg m².
        centre: centre of mass in the part's frame (p, 2), in m.
        position: origin of the part's frame relative to the ground under the spawn point (p, 2), in m.
        angle: angle of the part's frame (p,), in rad.
        friction: coefficient (p,).
        vertices: corners of all parts in their frames (v, 2), in m.
        first_vertex: part i has the vertices from `first_vertex[i]` to `first_vertex[i + 1]` (p + 1,).
        pushed: whether the push at an episode's start acts on a part (p,).
        joint_parts: indices of the two parts (h, 2).
        anchors: anchor in the frames of the two parts (h, 2, 2), in m.
        limits: smallest and largest angle of the second part relative to the first (h, 2), in rad.
        motors: number of joints with a motor.
    """

    mass: NDArray[np.float64]
    inertia: NDArray[np.float64]
    centre: NDArray[np.float64]
    position: NDArray[np.float64]
    angle: NDArray[np.float64]
    friction: NDArray[np.float64]
    vertices: NDArray[np.float64]
    first_vertex: NDArray[np.int64]
    pushed: NDArray[np.bool_]
    joint_parts: NDArray[np.int64]
    anchors: NDArray[np.float64]
    limits: NDArray[np.float64]
    motors: int


def body_arrays(body: Embodiment) -> BodyArrays:
    """Returns `body` as an engine builds it."""
    counts = [len(part.shape.vertices) for part in body.parts]
    joints = (*body.motors, *body.passive_joints)
    masses = [_mass(part, _welded(body, part)) for part in body.parts]
    return BodyArrays(
        mass=np.array([mass for mass, _, _ in masses]),
        inertia=np.array([inertia for _, _, inertia in masses]),
        centre=np.array([centre for _, centre, _ in masses]),
        position=np.array([part.position for part in body.parts]) + np.array([0.0, body.spawn_height]),
        angle=np.array([part.angle for part in body.parts]),
        friction=np.array([part.friction for part in body.parts]),
        vertices=np.concatenate([part.shape.points for part in body.parts]),
        first_vertex=np.concatenate([[0], np.cumsum(counts)]),
        pushed=np.array([body.pushed and (part.head or part.pushed) for part in body.parts]),
        joint_parts=joint_parts(body, joints),
        anchors=np.array([_local_anchors(body, joint) for joint in joints]).reshape(-1, 2, 2),
        limits=np.array([_limits(body, joint) for joint in joints]).reshape(-1, 2),
        motors=len(body.motors),
    )


def joint_parts(body: Embodiment, joints: tuple[Joint, ...]) -> NDArray[np.int64]:
    """Returns the indices of the two parts of each of `joints` (h, 2)."""
    pairs = [[body.part_index(j.part_a), body.part_index(j.part_b)] for j in joints]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def drawn_angle(body: Embodiment, joint: Joint) -> float:
    """Returns the angle of the joint's second part relative to the first where the joint's angle is 0."""
    first, second = (body.parts[body.part_index(name)] for name in (joint.part_a, joint.part_b))
    return second.angle - first.angle


def _welded(body: Embodiment, part: Part) -> list[GripSensor]:
    return [sensor for sensor in body.grip_sensors if sensor.part == part.name]


def _mass(part: Part, sensors: list[GripSensor]) -> tuple[float, Point, float]:
    """Returns mass, centre of mass and the inertia about it of `part` with its `sensors`."""
    if not sensors:
        return part.mass, part.shape.centroid, part.inertia
    masses = np.array([part.mass, *[sensor.mass for sensor in sensors]])
    points = np.array([part.shape.centroid, *[part.local(sensor.position) for sensor in sensors]])
    inertias = np.array([part.inertia, *[sensor.inertia for sensor in sensors]])
    x, y = centre = masses @ points / masses.sum()
    inertia = np.sum(inertias + masses * np.square(points - centre).sum(axis=1))
    return float(masses.sum()), (float(x), float(y)), float(inertia)


def _local_anchors(body: Embodiment, joint: Joint) -> list[Point]:
    parts = [body.parts[body.part_index(name)] for name in (joint.part_a, joint.part_b)]
    return [part.local(anchor) for part, anchor in zip(parts, joint.anchors, strict=True)]


def _limits(body: Embodiment, joint: Joint) -> list[float]:
    return [limit + drawn_angle(body, joint) for limit in joint.limits]
