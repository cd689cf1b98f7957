"""A body as arrays: what an engine builds, and what the kernels read at every step."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tma_ray.embodiments import Embodiment, Joint, Point

LIDARS = 10
"""Number of lidar rays."""

LIDAR_RANGE = 160 / 30
"""Length of a ray, in m."""

UPRIGHT_WEIGHT = 5.0
"""Reward per radian by which the head's tilt shrinks."""


class BodyArrays(NamedTuple):
    """p parts and h joints, those with motors first, as an engine builds them.

    Attributes:
        mass: (p,), in kg.
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


class StepArrays(NamedTuple):
    """What the kernels know of a body with p parts, j joints with motors and r lidar rays.

    Attributes:
        head: index of the head.
        critical: parts whose contact ends the episode (p,).
        joint_parts: indices of the two parts (j, 2).
        contact_part: part whose contact is observed after the joint, -1 for none (j,).
        motors: torque in N m, speed in rad/s, observed angle less that of the second part relative to the
            first in rad (j, 3).
        torque_cost: reward charged per action and step at full torque.
        upright_weight: reward per radian of tilt, 0 where the tilt does not count.
        rays: ends of the lidar rays relative to the head (r, 2), in m.
    """

    head: int
    critical: NDArray[np.bool_ | np.int64]
    joint_parts: NDArray[np.int64]
    contact_part: NDArray[np.int64]
    motors: NDArray[np.float64]
    torque_cost: float
    upright_weight: float
    rays: NDArray[np.float64]


def body_arrays(body: Embodiment) -> BodyArrays:
    """Returns `body` as an engine builds it."""
    counts = [len(part.shape.vertices) for part in body.parts]
    joints = (*body.motors, *body.passive_joints)
    return BodyArrays(
        mass=np.array([part.mass for part in body.parts]),
        inertia=np.array([part.inertia for part in body.parts]),
        centre=np.array([part.shape.centroid for part in body.parts]),
        position=np.array([part.position for part in body.parts]) + np.array([0.0, body.spawn_height]),
        angle=np.array([part.angle for part in body.parts]),
        friction=np.array([part.friction for part in body.parts]),
        vertices=np.concatenate([part.shape.points for part in body.parts]),
        first_vertex=np.concatenate([[0], np.cumsum(counts)]),
        pushed=np.array([part.head or part.pushed for part in body.parts]),
        joint_parts=_joint_parts(body, joints),
        anchors=np.array([_local_anchors(body, joint) for joint in joints]).reshape(-1, 2, 2),
        limits=np.array([_limits(body, joint) for joint in joints]).reshape(-1, 2),
        motors=len(body.motors),
    )


def step_arrays(
    body: Embodiment, lidar_angles: NDArray[np.float64], environment: str = "stump_tracks"
) -> StepArrays:
    """Returns what the kernels know of `body`.

    Args:
        body: the body.
        lidar_angles: directions of the rays (r,), in rad; 0 is straight down, pi/2 forward.
        environment: whose critical parts count.
    """
    joints = body.motors
    contacts = [-1 if j.contact_part is None else body.part_index(j.contact_part) for j in joints]
    motors = [(j.motor_torque, j.motor_speed, j.angle_offset - _drawn_angle(body, j)) for j in joints]
    return StepArrays(
        head=body.head,
        critical=np.array([environment in part.critical for part in body.parts]),
        joint_parts=_joint_parts(body, joints),
        contact_part=np.array(contacts, dtype=np.int64),
        motors=np.array(motors).reshape(-1, 3),
        torque_cost=body.torque_cost,
        upright_weight=UPRIGHT_WEIGHT if body.upright_reward else 0.0,
        rays=LIDAR_RANGE * np.stack([np.sin(lidar_angles), -np.cos(lidar_angles)], axis=1),
    )


def observation_size(arrays: StepArrays) -> int:
    """Returns the number of values that `observe` writes."""
    return int(4 + 2 * len(arrays.motors) + np.sum(arrays.contact_part >= 0) + len(arrays.rays))


def _joint_parts(body: Embodiment, joints: tuple[Joint, ...]) -> NDArray[np.int64]:
    pairs = [[body.part_index(j.part_a), body.part_index(j.part_b)] for j in joints]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def _local_anchors(body: Embodiment, joint: Joint) -> list[Point]:
    parts = [body.parts[body.part_index(name)] for name in (joint.part_a, joint.part_b)]
    return [part.local(anchor) for part, anchor in zip(parts, joint.anchors, strict=True)]


def _drawn_angle(body: Embodiment, joint: Joint) -> float:
    """Returns the angle of the joint's second part relative to the first where the joint's angle is 0."""
    first, second = (body.parts[body.part_index(name)] for name in (joint.part_a, joint.part_b))
    return second.angle - first.angle


def _limits(body: Embodiment, joint: Joint) -> list[float]:
    return [limit + _drawn_angle(body, joint) for limit in joint.limits]
