"""A window that shows frames at the pace of the simulation."""

from __future__ import annotations

import pygame

from tma_ray.envs.drawing.camera import HEIGHT, WIDTH


class Window:
    """Shows frames.

    Args:
        frames_per_second: pace.
    """

    def __init__(self, frames_per_second: int) -> None:
        pygame.display.init()
        pygame.display.set_caption("tma_ray")
        self._frames_per_second = frames_per_second
        self._surface = pygame.display.set_mode((WIDTH, HEIGHT))
        self._clock = pygame.time.Clock()

    def show(self, frame: pygame.Surface) -> None:
        """Shows `frame`, and waits until it is time for the next."""
        self._surface.blit(frame, (0, 0))
        pygame.event.pump()
        pygame.display.flip()
        self._clock.tick(self._frames_per_second)

    def close(self) -> None:
        """Closes it."""
        pygame.display.quit()
