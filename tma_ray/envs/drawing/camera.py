"""The camera of a frame, placed by the head alone, so that the same pose is always drawn alike."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tma_ray.terrain import GROUND_HEIGHT, Terrain

WIDTH, HEIGHT = 600, 400
"""Size of a frame, in pixels."""

PIXELS_PER_METRE = 48
"""Of the nearest view, and of every view under an open sky."""

HEAD_SHARE = 0.3
"""Where the camera keeps the head, as a share of the width: the lidars look ahead."""

GROUND_SHARE = 0.22
"""Height of the ground in the frame, as a share of the frame's, while the head is low enough."""

HIGHEST_VIEW = 12.0
"""How much of a high passage is shown, in m."""

PASSAGE_SHARE = 0.8
"""Share of the frame's height that a lower passage takes."""

SOLID_SHARE = 0.12
"""Share of the frame's height that is ground in the lowest view, and ceiling in the highest."""

HEAD_MARGIN = 0.15
"""How near to the upper and lower edge the head may come, as a share of the frame's height."""

REACH = 5.0
"""Ground and ceiling are averaged so far behind and ahead of the head, in m: else the camera would shake."""


class View(NamedTuple):
    """The part of the world that a frame shows.

    Attributes:
        left: x of the left edge, in m.
        bottom: y of the lower edge, in m.
        scale: pixels of a frame per m.
    """

    left: float
    bottom: float
    scale: float

    @property
    def right(self) -> float:
        """The right edge (x), in m."""
        return self.left + WIDTH / self.scale

    @property
    def top(self) -> float:
        """The upper edge (y), in m."""
        return self.bottom + HEIGHT / self.scale


def view_of(head: NDArray[np.float64], terrain: Terrain) -> View:
    """Returns what to show when the head is at `head` (2,).

    Under an open sky the scale is fixed, and the camera rises only with a head that would leave the frame.
    Under a ceiling it follows the head, and shows the whole passage where that is low.
    """
    x, y = float(head[0]), float(head[1])
    if not len(terrain.ceiling):
        height = HEIGHT / PIXELS_PER_METRE
        left = x - HEAD_SHARE * WIDTH / PIXELS_PER_METRE
        return View(left, max(GROUND_HEIGHT - GROUND_SHARE * height, y - 0.8 * height), PIXELS_PER_METRE)
    floor, roof = _around(terrain.surface, x), _around(terrain.ceiling, x)
    height = float(np.clip((roof - floor) / PASSAGE_SHARE, HEIGHT / PIXELS_PER_METRE, HIGHEST_VIEW))
    lowest, highest = floor + (0.5 - SOLID_SHARE) * height, roof - (0.5 - SOLID_SHARE) * height
    middle = (floor + roof) / 2 if lowest > highest else float(np.clip(y, lowest, highest))
    off = (0.5 - HEAD_MARGIN) * height
    middle = float(np.clip(middle, y - off, y + off))
    scale = HEIGHT / height
    return View(x - HEAD_SHARE * WIDTH / scale, middle - height / 2, scale)


def height_at(segments: NDArray[np.float64], x: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """Returns the height of ground or ceiling, `segments` as in Terrain (m, 4), at each of `x`, in m."""
    ends = np.append(segments[:, 0], segments[-1, 2]), np.append(segments[:, 1], segments[-1, 3])
    return np.asarray(np.interp(x, *ends))


def _around(segments: NDArray[np.float64], x: float) -> float:
    """Returns the mean height around `x`, what is near counting most."""
    offsets = np.linspace(-1, 1, 41)
    weights = 1 + np.cos(np.pi * offsets)
    return float(np.average(height_at(segments, x + REACH * offsets), weights=weights))
