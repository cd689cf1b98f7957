"""Draws a body, what it grips with and what it sees."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tma_ray.embodiments import Embodiment, Part
from tma_ray.envs.drawing.palette import Colour, DEAD_FAR_LIMB, DEAD_HEAD, DEAD_LIMB, DEAD_OUTLINE, FAR_LIMB, GRIP_FREE, GRIP_HOLDING, GRIP_TOUCHING, HEAD, LIDAR, LIDAR_CREEPER, LIDAR_WATER, LIMB, OUTLINE
from tma_ray.envs.drawing.canvas import Canvas
from tma_ray.envs.drawing.scene import Scene

SMALLEST_GRIP = 4.0
"""Radius at which a grip sensor is drawn if its own were smaller, in pixels."""

Floats = NDArray[np.float64]


class BodyPainter:
    """Draws one body in all its poses."""

    def __init__(self, body: Embodiment) -> None:
        self._body = body
        self._far = [_hidden(part, body.parts[:index]) for index, part in enumerate(body.parts)]

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Draws the parts from the last, which is farthest away, to the head; grey if it is dead."""
        body, poses = self._body, scene.poses
        head, limb, far_limb, outline = _colours(scene.dead)
        for joint in body.joints:
            if joint.outside_parts:  # a neck
                first, second = (body.part_index(name) for name in (joint.part_a, joint.part_b))
                end = placed(poses[second], np.array(body.parts[second].local(joint.anchors[1])))
                canvas.line(np.stack([poses[first, :2], end]), outline, 5)
        for part in sorted(range(len(poses)), key=lambda part: (part == body.head, -part)):
            colour = head if part == body.head else (far_limb if self._far[part] else limb)
            canvas.fill(placed(poses[part], body.parts[part].shape.points), colour, outline)
        self._draw_grips(canvas, scene, outline)

    def _draw_grips(self, canvas: Canvas, scene: Scene, outline: Colour) -> None:
        for sensor, (touches, holds) in zip(self._body.grip_sensors, scene.grips, strict=True):
            part = self._body.part_index(sensor.part)
            centre = placed(scene.poses[part], np.array(self._body.parts[part].local(sensor.position)))
            radius = max(SMALLEST_GRIP, sensor.radius * canvas.view.scale)
            colour = GRIP_TOUCHING if touches else GRIP_FREE
            canvas.dot(centre, outline, radius + 1)
            canvas.dot(centre, GRIP_HOLDING if holds else colour, radius)


def draw_lidars(canvas: Canvas, head: Floats, scene: Scene) -> None:
    """Draws the rays, coloured by what they hit."""
    for end, hit in zip(scene.lidars, scene.hits, strict=True):
        colour = LIDAR_CREEPER if hit > 0 else LIDAR_WATER if hit < 0 else LIDAR
        canvas.line(np.stack([head, end]), colour, 1)
        canvas.dot(end, colour, 2.5)


def placed(pose: Floats, points: Floats) -> Floats:
    """Returns `points` (..., 2) of a frame at `pose` (x, y, angle) in world axes."""
    sine, cosine = np.sin(pose[2]), np.cos(pose[2])
    return np.asarray(pose[:2] + points @ np.array([[cosine, sine], [-sine, cosine]]))


def _colours(dead: bool) -> tuple[Colour, Colour, Colour, Colour]:
    """Returns the colours of the head, of limbs, of those behind others, and of outlines."""
    if dead:
        return DEAD_HEAD, DEAD_LIMB, DEAD_FAR_LIMB, DEAD_OUTLINE
    return HEAD, LIMB, FAR_LIMB, OUTLINE


def _hidden(part: Part, nearer: tuple[Part, ...]) -> bool:
    """Tells whether one of the `nearer` parts is drawn like `part` and in the same place."""
    return any(other.position == part.position and other.shape == part.shape for other in nearer)
