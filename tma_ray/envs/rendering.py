"""Draws a body in its world with pygame, as frames or in a window."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tma_ray.embodiments import Embodiment
from tma_ray.envs.drawing.body import BodyPainter, draw_lidars
from tma_ray.envs.drawing.camera import HEIGHT, WIDTH, view_of
from tma_ray.envs.drawing.canvas import Canvas
from tma_ray.envs.drawing.scene import Scene
from tma_ray.envs.drawing.world import draw_goal, draw_progress, draw_world, flood

import pygame  # after canvas, which asks it not to print

__all__ = ["Renderer", "Scene"]


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
        self._frames_per_second = frames_per_second
        self._canvas = Canvas()
        self._window: pygame.Surface | None = None
        if window:
            pygame.display.init()
            pygame.display.set_caption("tma_ray")
            self._window = pygame.display.set_mode((WIDTH, HEIGHT))
            self._clock = pygame.time.Clock()

    def draw(self, scene: Scene) -> NDArray[np.uint8] | None:
        """Returns the frame (400, 600, 3), or shows it and returns None if there is a window."""
        head, canvas = scene.poses[self._head, :2], self._canvas
        canvas.start(view_of(head, scene.terrain))
        draw_goal(canvas, scene.terrain)
        draw_world(canvas, scene)
        draw_lidars(canvas, head, scene)
        self._body.draw(canvas, scene)
        flood(canvas, scene.terrain.water_y)
        draw_progress(canvas, float(head[0]), scene.terrain)
        frame = canvas.frame()
        if self._window is None:
            return np.ascontiguousarray(pygame.surfarray.array3d(frame).transpose(1, 0, 2))
        self._window.blit(frame, (0, 0))
        pygame.event.pump()
        pygame.display.flip()
        self._clock.tick(self._frames_per_second)
        return None

    def close(self) -> None:
        """Closes the window."""
        if self._window is not None:
            pygame.display.quit()
            self._window = None
