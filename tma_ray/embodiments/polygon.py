"""Convex polygons: area, centroid and second moment in closed form."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Point = tuple[float, float]


@dataclass(frozen=True)
class Polygon:
    """A convex polygon with counter-clockwise vertices.

    Attributes:
        vertices: at least three corners (x, y), in m.

    Raises:
        ValueError: fewer than three vertices, or not convex and counter-clockwise.
    """

    vertices: tuple[Point, ...]

    def __post_init__(self) -> None:
        if len(self.vertices) < 3:
            raise ValueError(f"a polygon needs at least 3 vertices, got {len(self.vertices)}")
        if not np.all(np.isfinite(self.points)):
            raise ValueError(f"vertices must be finite, got {list(self.vertices)}")
        edges = np.roll(self.points, -1, axis=0) - self.points
        turns = _cross(edges, np.roll(edges, -1, axis=0))
        total_turn = np.sum(np.arctan2(turns, np.sum(edges * np.roll(edges, -1, axis=0), axis=1)))
        if not (np.all(turns > 0) and np.isclose(total_turn, 2 * np.pi)):
            raise ValueError(
                f"vertices must form a convex polygon, counter-clockwise, got {list(self.vertices)}; "
                f"reorder them or split the shape into several parts"
            )

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """Vertices as an array (v, 2)."""
        return np.array(self.vertices, dtype=np.float64)

    @cached_property
    def area(self) -> float:
        """Area in m²."""
        return float(np.sum(self._wedges) / 2)

    @cached_property
    def centroid(self) -> Point:
        """Centre of mass at uniform density."""
        sums = self.points + np.roll(self.points, -1, axis=0)
        x, y = (sums * self._wedges[:, None]).sum(axis=0) / (6 * self.area)
        return float(x), float(y)

    @cached_property
    def second_moment(self) -> float:
        """Polar second moment of area about the centroid, in m⁴; times density it is the inertia."""
        a, b = self.points, np.roll(self.points, -1, axis=0)
        about_origin = np.sum(self._wedges * np.sum(a * a + a * b + b * b, axis=1)) / 12
        return float(about_origin - self.area * np.sum(np.square(self.centroid)))

    def distance(self, point: Point) -> float:
        """Returns how far `point` lies outside the polygon along its worst edge, in m; <= 0 inside."""
        edges = np.roll(self.points, -1, axis=0) - self.points
        outwards = _cross(np.asarray(point) - self.points, edges) / np.hypot(edges[:, 0], edges[:, 1])
        return float(np.max(outwards))

    @cached_property
    def _wedges(self) -> NDArray[np.float64]:
        return _cross(self.points, np.roll(self.points, -1, axis=0))


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
