"""Closed forms of areas, centroids and moments."""

import numpy as np
import pytest

from tma_ray.embodiments import Polygon


@pytest.mark.parametrize("corners", [3, 4, 5, 8])
@pytest.mark.parametrize("centre", [(0.0, 0.0), (2.5, -1.0)])
def test_regular_polygon_has_the_textbook_area_and_moment(corners: int, centre: tuple[float, float]) -> None:
    radius, angles = 0.7, 2 * np.pi * np.arange(corners) / corners
    points = np.array(centre) + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    polygon = Polygon(tuple(map(tuple, points.tolist())))
    area = corners / 2 * radius**2 * np.sin(2 * np.pi / corners)
    assert polygon.area == pytest.approx(area)
    assert polygon.centroid == pytest.approx(centre)
    expected = area * radius**2 / 2 * (1 - 2 / 3 * np.sin(np.pi / corners) ** 2)
    assert polygon.second_moment == pytest.approx(expected)


def test_rectangle_off_its_origin() -> None:
    polygon = Polygon(((1.0, 2.0), (4.0, 2.0), (4.0, 4.0), (1.0, 4.0)))
    assert polygon.area == pytest.approx(6)
    assert polygon.centroid == pytest.approx((2.5, 3))
    assert polygon.second_moment == pytest.approx(6 * (3**2 + 2**2) / 12)


def test_distance_is_negative_inside_and_positive_outside() -> None:
    polygon = Polygon(((0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (0.0, 1.0)))
    assert polygon.distance((1.0, 0.5)) == pytest.approx(-0.5)
    assert polygon.distance((1.0, 1.25)) == pytest.approx(0.25)


@pytest.mark.parametrize(
    ("vertices", "message"),
    [
        (((0.0, 0.0), (1.0, 0.0)), "at least 3"),
        (((0.0, 0.0), (0.0, 1.0), (1.0, 0.0)), "counter-clockwise"),
        (((0.0, 0.0), (2.0, 0.0), (0.5, 0.5), (0.0, 2.0)), "convex"),
        (((1.0, 0.0), (-0.8, 0.6), (0.3, -0.95), (0.3, 0.95), (-0.8, -0.6)), "convex"),  # a star
        (((0.0, 0.0), (1.0, 0.0), (float("nan"), 1.0)), "finite"),
    ],
)
def test_shapes_that_are_no_convex_polygon_are_refused(vertices, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Polygon(vertices)
