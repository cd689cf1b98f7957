"""Widgets of live play: a slider, and text with all signs of the units, cut and wrapped to fit."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Final

import pygame
from matplotlib import get_data_path

from tma_ray.envs.drawing import HEAD, LIMB, Colour
from tma_ray.tasks import Dimension

TEXT_SIZE, SMALL_SIZE = 13, 11
"""Heights of letters, in pixels."""

INK: Final[Colour] = (38, 44, 56)
FAINT: Final[Colour] = (112, 120, 134)

SLIDER_HEIGHT: Final = 62
"""Of a slider with its text, in pixels."""

KNOB: Final = 8
"""Radius of what is dragged, in pixels."""

TRACK: Final[Colour] = (206, 211, 220)
_TRACK_Y: Final = 27
_GAP: Final = 8


@cache
def font(size: int, bold: bool = False) -> pygame.font.Font:
    """Returns a font; nothing but fonts is initialised."""
    pygame.font.init()
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return pygame.font.Font(Path(get_data_path()) / "fonts" / "ttf" / name, size)


def signed(number: str) -> str:
    """Returns a number as text with a minus sign instead of a hyphen."""
    return number.replace("-", "\N{MINUS SIGN}")


def elided(text: str, width: int, letters: pygame.font.Font) -> str:
    """Returns `text`, or its beginning and an ellipsis, not wider than `width` pixels."""
    if letters.size(text)[0] <= width:
        return text
    while text and letters.size(f"{text}…")[0] > width:
        text = text[:-1].rstrip()
    return f"{text}…" if text else ""


def wrapped(parts: list[str], width: int, letters: pygame.font.Font, gap: str = "  ·  ") -> list[str]:
    """Returns lines not wider than `width` pixels, each with as many of the `parts` as fit."""
    lines: list[str] = []
    for part in parts:
        longer = f"{lines[-1]}{gap}{part}" if lines else part
        if lines and letters.size(longer)[0] <= width:
            lines[-1] = longer
        else:
            lines.append(elided(part, width, letters))
    return lines


def draw_text(
    surface: pygame.Surface,
    text: str,
    place: tuple[int, int],
    letters: pygame.font.Font,
    colour: Colour = INK,
    right: bool = False,
) -> None:
    """Writes `text` with its upper left corner, or its upper right one, at `place`."""
    drawn = letters.render(text, True, colour)
    surface.blit(drawn, drawn.get_rect(topright=place) if right else place)


class Slider:
    """Chooses a value of one dimension.

    Above its track it shows name and value, below it both bounds and the unit. The part of the track that a
    teacher may choose from is coloured.

    Args:
        domain: name, unit and bounds of the values.
        usual: low and high of what a teacher may choose.
        value: at first.

    Attributes:
        value: where the knob is.
        dragged: whether it is being dragged.
        area: where it is on the surface.
    """

    def __init__(self, domain: Dimension, usual: tuple[float, float], value: float) -> None:
        self.domain, self.usual, self.value = domain, usual, value
        self.dragged = False
        self.area = pygame.Rect(0, 0, 200, SLIDER_HEIGHT)

    def handle(self, event: pygame.event.Event) -> bool:
        """Follows the mouse; returns whether it was let go of, so that its value is chosen."""
        if event.type == pygame.MOUSEBUTTONDOWN and event.button == 1 and self.area.collidepoint(event.pos):
            self.dragged = True
        elif event.type == pygame.MOUSEBUTTONUP and event.button == 1 and self.dragged:
            self.value, self.dragged = self.value_at(event.pos[0]), False
            return True
        if self.dragged and hasattr(event, "pos"):
            self.value = self.value_at(event.pos[0])
        return False

    def value_at(self, x: float) -> float:
        """Returns the value at a place on the surface."""
        left, width = self._track()
        share = min(max((x - left) / width, 0.0), 1.0)
        return self.domain.low + share * (self.domain.high - self.domain.low)

    def x_of(self, value: float) -> float:
        """Returns where a value is on the surface."""
        left, width = self._track()
        span = self.domain.high - self.domain.low
        return left + width * ((value - self.domain.low) / span if span else 0.5)

    def draw(self, surface: pygame.Surface) -> None:
        """Draws it into its area."""
        self._draw_text(surface)
        y = self.area.top + _TRACK_Y
        for (low, high), colour, width in (
            ((self.domain.low, self.domain.high), TRACK, 4),
            (self.usual, LIMB, 4),
        ):
            left, right = self.x_of(low), self.x_of(high)
            bar = pygame.Rect(round(left), y - width // 2, max(round(right - left), 1), width)
            pygame.draw.rect(surface, colour, bar, border_radius=width // 2)
        centre = (round(self.x_of(self.value)), y)
        pygame.draw.aacircle(surface, HEAD, centre, KNOB + self.dragged)
        pygame.draw.aacircle(surface, (255, 255, 255), centre, KNOB - 4)

    def _draw_text(self, surface: pygame.Surface) -> None:
        area, small = self.area, font(SMALL_SIZE)
        value = signed(f"{self.value:.3g}")
        bold = font(TEXT_SIZE, bold=True)
        draw_text(surface, value, area.topright, bold, right=True)
        name = elided(
            self.domain.name.replace("_", " "), area.width - bold.size(value)[0] - _GAP, font(TEXT_SIZE)
        )
        draw_text(surface, name, area.topleft, font(TEXT_SIZE), INK)
        below = area.top + _TRACK_Y + KNOB + 3
        low, high = signed(f"{self.domain.low:g}"), signed(f"{self.domain.high:g}")
        draw_text(surface, low, (area.left, below), small, FAINT)
        draw_text(surface, high, (area.right, below), small, FAINT, right=True)
        room = area.width - 2 * max(small.size(low)[0], small.size(high)[0]) - 2 * _GAP
        unit = elided(self.domain.unit, room, small)
        draw_text(surface, unit, (area.centerx - small.size(unit)[0] // 2, below), small, FAINT)

    def _track(self) -> tuple[float, float]:
        return self.area.left + KNOB, max(self.area.width - 2 * KNOB, 1)
