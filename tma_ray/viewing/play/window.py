"""The window: what the board shows, as fast as the world's own time."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from typing import Final

import pygame

from tma_ray.viewing.play.board import Board

FRAMES_PER_SECOND: Final = 60
"""At most."""

SMALLEST: Final = (400, 320)
"""Width and height that may be asked for, in pixels; whoever makes a window smaller sees less."""

NO_DISPLAY: Final = "no display: use -o FILE.mp4 or -o FILE.gif to make a video without one"

_WITHOUT_SCREEN: Final = ("dummy", "offscreen")


class Window:
    """Shows a board, whose session goes on.

    Args:
        board: what is shown.
        size: at first; the user may change it.
        title: of the window.

    Raises:
        ValueError: no display is available.
    """

    def __init__(self, board: Board, size: tuple[int, int], title: str) -> None:
        check_display()
        self._board = board
        try:
            pygame.display.init()  # no sound, no joysticks
            if pygame.display.get_driver() in _WITHOUT_SCREEN and "SDL_VIDEODRIVER" not in os.environ:
                raise pygame.error("only drivers without a screen")
            pygame.display.set_caption(title)
            self._surface = pygame.display.set_mode(size, pygame.RESIZABLE)
        except pygame.error as error:
            pygame.display.quit()
            raise ValueError(f"{NO_DISPLAY} ({error})") from error
        self._clock = pygame.time.Clock()

    @property
    def surface(self) -> pygame.Surface:
        """What is shown now."""
        return self._surface

    def run(self) -> None:
        """Shows frames until somebody leaves, also with Ctrl-C."""
        self._clock.tick()
        with suppress(KeyboardInterrupt):
            while self.turn(self._clock.tick(FRAMES_PER_SECOND) / 1000):
                pass

    def turn(self, seconds: float) -> bool:
        """Takes up what was asked for, goes on for `seconds` and shows that; returns whether to go on."""
        for event in pygame.event.get():
            self._board.handle(event)
        if self._board.open:
            self._board.session.advance(seconds)
            self._surface = pygame.display.get_surface() or self._surface
            if min(self._surface.get_size()) > 0:
                self._board.draw(self._surface, self._clock.get_fps())
            pygame.display.flip()
        return self._board.open

    def close(self) -> None:
        """Closes it, and nothing else of pygame."""
        pygame.display.quit()


def check_display() -> None:
    """Refuses a machine without a display, as far as its environment tells.

    Raises:
        ValueError: there is none.
    """
    named = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"))
    if sys.platform.startswith("linux") and not named:
        raise ValueError(NO_DISPLAY)
