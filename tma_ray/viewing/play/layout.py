"""The layout of world, sliders and text in a window of any size."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import pygame

from tma_ray.viewing.play.widgets import SLIDER_HEIGHT

MARGIN: Final = 14
LINE: Final = 19
"""Height of a line of text, in pixels."""

COLUMN, NARROW_COLUMN = 210, 110
"""Least width of a slider where there are several in a row, and where the window is low, in pixels."""

PANEL_SHARE: Final = 0.6
"""Share of the window's height from which a panel beneath the world has narrow columns."""

BESIDE: Final = 300
"""Width of a panel beside the world, in pixels."""

Lines = Callable[[int], int]
"""Tells how many lines of text a panel of some width needs."""


@dataclass(frozen=True)
class Layout:
    """Places of everything, in pixels.

    Attributes:
        world: the frame of the world, in its own proportions; empty in a window that is too small.
        panel: behind sliders and text.
        sliders: each one's area.
        text: of the lines under the sliders.
    """

    world: pygame.Rect
    panel: pygame.Rect
    sliders: tuple[pygame.Rect, ...]
    text: pygame.Rect


def compute_layout(size: tuple[int, int], frame: tuple[int, int], sliders: int, lines: Lines) -> Layout:
    """Returns the panel beneath the world or beside it, whichever leaves more room for the world.

    Args:
        size: of the window.
        frame: width and height of a frame of the world, whose proportions are kept.
        sliders: number of sliders.
        lines: of text.
    """
    width, height = size
    tall, grid = panel_height(width, sliders, lines), _grid(width, sliders)
    if tall > PANEL_SHARE * height:
        tall -= grid[0] * SLIDER_HEIGHT
        grid = _grid(width, sliders, NARROW_COLUMN)
        tall += grid[0] * SLIDER_HEIGHT
    top = max(height - tall, 0)
    beneath = _whole(pygame.Rect(0, 0, width, top), pygame.Rect(0, top, width, tall), frame, sliders, grid)
    if width < 2 * BESIDE or height < panel_height(BESIDE, sliders, lines):
        return beneath
    world = pygame.Rect(0, 0, width - BESIDE, height)
    panel = pygame.Rect(width - BESIDE, 0, BESIDE, height)
    beside = _whole(world, panel, frame, sliders, _grid(BESIDE, sliders))
    return beside if beside.world.width > beneath.world.width else beneath


def panel_height(width: int, sliders: int, lines: Lines) -> int:
    """Returns how high a panel of some width is."""
    rows = _grid(width, sliders)[0]
    return rows * SLIDER_HEIGHT + lines(width - 2 * MARGIN) * LINE + 2 * MARGIN


def _grid(width: int, sliders: int, column: int = COLUMN) -> tuple[int, int]:
    """Returns rows and columns of sliders, as even as possible, in columns of at least that width."""
    most = max((width - MARGIN) // (column + MARGIN), 1)
    rows = math.ceil(sliders / most)
    return rows, math.ceil(sliders / rows) if rows else 1


def _whole(
    room: pygame.Rect, panel: pygame.Rect, frame: tuple[int, int], sliders: int, grid: tuple[int, int]
) -> Layout:
    rows, columns = grid
    share = (panel.width - MARGIN) / columns
    areas = tuple(
        pygame.Rect(
            panel.left + MARGIN + round(index % columns * share),
            panel.top + MARGIN + index // columns * SLIDER_HEIGHT,
            round(share) - MARGIN,
            SLIDER_HEIGHT - 6,
        )
        for index in range(sliders)
    )
    top = panel.top + MARGIN + rows * SLIDER_HEIGHT
    text = pygame.Rect(
        panel.left + MARGIN, top, panel.width - 2 * MARGIN, max(panel.bottom - MARGIN - top, 0)
    )
    return Layout(_fitting(room, frame), panel, areas, text)


def _fitting(room: pygame.Rect, frame: tuple[int, int]) -> pygame.Rect:
    """Returns the largest rectangle with the proportions of `frame` in the middle of `room`."""
    scale = max(min(room.width / frame[0], room.height / frame[1]), 0.0)
    fitting = pygame.Rect(0, 0, round(frame[0] * scale), round(frame[1] * scale))
    fitting.center = room.center
    return fitting
