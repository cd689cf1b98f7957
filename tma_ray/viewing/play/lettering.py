"""Text in a window: a font with all signs of the units, cut and broken to fit."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Final

import pygame
from matplotlib import get_data_path

from tma_ray.envs.drawing.palette import Colour

TEXT_SIZE, SMALL_SIZE = 13, 11
"""Heights of letters, in pixels."""

INK: Final[Colour] = (38, 44, 56)
FAINT: Final[Colour] = (112, 120, 134)


@cache
def font(size: int, bold: bool = False) -> pygame.font.Font:
    """Returns a font; nothing but fonts is initialised."""
    pygame.font.init()
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return pygame.font.Font(Path(get_data_path()) / "fonts" / "ttf" / name, size)


def signed(number: str) -> str:
    """Returns a number as text with a minus sign instead of a hyphen."""
    return number.replace("-", "\N{MINUS SIGN}")


def fitted(text: str, width: int, letters: pygame.font.Font) -> str:
    """Returns `text`, or its beginning and an ellipsis, not wider than `width` pixels."""
    if letters.size(text)[0] <= width:
        return text
    while text and letters.size(f"{text}…")[0] > width:
        text = text[:-1].rstrip()
    return f"{text}…" if text else ""


def broken(parts: list[str], width: int, letters: pygame.font.Font, gap: str = "  ·  ") -> list[str]:
    """Returns lines not wider than `width` pixels, each with as many of the `parts` as fit."""
    lines: list[str] = []
    for part in parts:
        longer = f"{lines[-1]}{gap}{part}" if lines else part
        if lines and letters.size(longer)[0] <= width:
            lines[-1] = longer
        else:
            lines.append(fitted(part, width, letters))
    return lines


def write(
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
