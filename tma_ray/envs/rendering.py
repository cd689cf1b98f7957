"""Draws a body in its world with pygame, as frames or in a window."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tma_ray.embodiments import Embodiment
from tma_ray.envs.drawing.body import BodyPainter, draw_lidars
from tma_ray.envs.drawing.camera import view_of
from tma_ray.envs.drawing.canvas import Canvas
from tma_ray.envs.drawing.look import Look
from tma_ray.envs.drawing.scene import Scene
from tma_ray.envs.drawing.window import Window
from tma_ray.envs.drawing.world import draw_goal, draw_progress, draw_water, draw_world

__all__ = ["Renderer", "Scene"]

DEFAULT_LOOK = Look()


class Renderer:
    """Draws frames of one body.

    Args:
        body: whose shapes are drawn.
        window: whether frames are also shown, at the pace of the simulation.
        frames_per_second: pace of the window.
    """

    def __init__(self, body: Embodiment, window: bool, frames_per_second: int) -> None:
        self._body = BodyPainter(body)
        self._head = body.head
        self._canvas = Canvas()
        self._window = Window(frames_per_second) if window else None

    def draw(self, scene: Scene, look: Look = DEFAULT_LOOK) -> NDArray[np.uint8] | None:
        """Returns the frame (400, 600, 3), or shows it and returns None if there is a window."""
        head, canvas = scene.poses[self._head, :2], self._canvas
        canvas.start(view_of(head, scene.terrain))
        draw_goal(canvas, scene.terrain)
        draw_world(canvas, scene)
        if look.lidars:
            draw_lidars(canvas, head, scene)
        self._body.draw(canvas, scene)
        draw_water(canvas, scene.terrain.water_y)
        draw_progress(canvas, float(head[0]), scene.terrain)
        if self._window is None:
            return canvas.pixels(look.smooth)
        self._window.show(canvas.frame())
        return None

    def close(self) -> None:
        """Closes the window."""
        if self._window is not None:
            self._window.close()
            self._window = None
