"""A surface that is drawn on in metres."""

from __future__ import annotations

import numpy as np
import pygame
from numpy.typing import NDArray

from tma_ray.envs.drawing.camera import HEIGHT, WIDTH, View
from tma_ray.envs.drawing.palette import SKY_BOTTOM, SKY_TOP, Colour

SUPERSAMPLING = 2
CROP = 10.0
"""Shapes are cut off this far outside the frame, in m: pygame's coordinates are small."""

Floats = NDArray[np.float64]


class Canvas:
    """Draws lines, outlines and text in world coordinates; widths are in pixels of a frame.

    Attributes:
        view: what the frame shows.
    """

    def __init__(self) -> None:
        self.surface = pygame.Surface((WIDTH * SUPERSAMPLING, HEIGHT * SUPERSAMPLING))
        self._glass = pygame.Surface(self.surface.get_size())
        self._sky = _gradient(self.surface.get_size(), SKY_TOP, SKY_BOTTOM)
        pygame.font.init()
        self._font = pygame.font.Font(None, 18 * SUPERSAMPLING)

    def start(self, view: View) -> None:
        """Begins a frame with an empty sky."""
        self.view = view
        self.surface.blit(self._sky, (0, 0))

    def frame(self) -> pygame.Surface:
        """Returns the frame, smoothed."""
        return pygame.transform.smoothscale(self.surface, (WIDTH, HEIGHT))

    def pixels(self, smooth: bool = True) -> NDArray[np.uint8]:
        """Returns the frame (height, width, 3), or larger and rough, as it was drawn."""
        frame = self.frame() if smooth else self.surface
        return pixels_of(frame)

    def line(self, ends: Floats, colour: Colour, width: int) -> None:
        """Draws a line between two points (2, 2)."""
        start, end = self._pixels(self._cropped(ends)).tolist()
        pygame.draw.line(self.surface, colour, start, end, width * SUPERSAMPLING)

    def fill(self, points: Floats, colour: Colour, outline: Colour | None = None) -> None:
        """Draws an area with the corners `points` (n, 2), and its outline."""
        corners = self._pixels(self._cropped(points)).tolist()
        pygame.draw.polygon(self.surface, colour, corners)
        if outline is not None:
            pygame.draw.polygon(self.surface, outline, corners, 2 * SUPERSAMPLING)

    def dot(self, point: Floats, colour: Colour, radius: float) -> None:
        """Draws a circle with a radius in pixels."""
        centre = self._pixels(self._cropped(point)).tolist()
        pygame.draw.circle(self.surface, colour, centre, radius * SUPERSAMPLING)

    def tint(self, top: float, colour: Colour, opacity: int) -> None:
        """Lays a pane of `colour` over everything under the height `top` in m; 255 would hide it."""
        height = HEIGHT * SUPERSAMPLING
        row = int(np.clip((self.view.top - top) * self.view.scale * SUPERSAMPLING, 0, height))
        self._glass.fill(colour)
        self._glass.set_alpha(opacity)
        self.surface.blit(self._glass, (0, row), (0, 0, WIDTH * SUPERSAMPLING, height - row))

    def text(self, point: Floats, text: str, colour: Colour) -> None:
        """Writes under a point (2,)."""
        drawn = self._font.render(text, True, colour)
        self.surface.blit(drawn, drawn.get_rect(midtop=self._pixels(point).tolist()))

    def bar(self, share: float, colours: tuple[Colour, Colour, Colour]) -> None:
        """Draws along the top how much of a way is done, in colours of the way, what is done, and the end."""
        left, right, y = (SUPERSAMPLING * value for value in (20, WIDTH - 20, 16))
        at, (way, done, end) = left + share * (right - left), colours
        pygame.draw.line(self.surface, way, (left, y), (right, y), 2 * SUPERSAMPLING)
        pygame.draw.line(self.surface, done, (left, y), (at, y), 4 * SUPERSAMPLING)
        pygame.draw.circle(self.surface, done, (at, y), 5 * SUPERSAMPLING)
        pygame.draw.circle(self.surface, end, (right, y), 4 * SUPERSAMPLING)

    def sees(self, left: Floats, right: Floats) -> NDArray[np.bool_]:
        """Tells of things that reach from x = `left` to `right` (n,) whether the frame shows them (n,)."""
        return np.asarray((right >= self.view.left) & (left <= self.view.right))

    def _pixels(self, points: Floats) -> Floats:
        """Returns world `points` (..., 2) in pixels of the surface."""
        scale = self.view.scale * SUPERSAMPLING
        x = (points[..., 0] - self.view.left) * scale
        y = HEIGHT * SUPERSAMPLING - (points[..., 1] - self.view.bottom) * scale
        return np.stack([x, y], axis=-1)

    def _cropped(self, points: Floats) -> Floats:
        low = np.array([self.view.left - CROP, self.view.bottom - CROP])
        return np.clip(points, low, np.array([self.view.right + CROP, self.view.top + CROP]))


def pixels_of(surface: pygame.Surface) -> NDArray[np.uint8]:
    """Returns what is on `surface` (height, width, 3), writable."""
    width, height = surface.get_size()
    content = bytearray(pygame.image.tobytes(surface, "RGB"))  # several times faster than pygame.surfarray
    return np.frombuffer(content, np.uint8).reshape(height, width, 3)


def _gradient(size: tuple[int, int], top: Colour, bottom: Colour) -> pygame.Surface:
    strip = pygame.Surface((1, 2))
    strip.set_at((0, 0), top)
    strip.set_at((0, 1), bottom)
    return pygame.transform.smoothscale(strip, size)
