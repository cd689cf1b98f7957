"""The terrains of the shipped network resemble the original release's (tests/reference/terrain.csv)."""

import csv
from pathlib import Path

import numpy as np
import pytest

from tma_ray.terrain.base import STARTPAD_STEPS, STEP
from tma_ray.terrain.parkour import CPPN, outlines

BOXES = {
    "easy": ((-0.25, -0.05), (0.8, 1.0), (0.0, 0.2)),
    "medium": ((-0.35, 0.05), (0.6, 1.0), (-0.1, 0.3)),
    "hard": ((-1.0, 1.0), (-1.0, 1.0), (-1.0, 1.0)),
}
"""The paper's spaces of theta (appendix C)."""

DELTA, TASKS = 10.0, 400


@pytest.fixture(scope="module")
def release() -> dict[tuple[str, str], float]:
    """Means of the release's terrains, by box and figure."""
    path = Path(__file__).parents[1] / "reference" / "terrain.csv"
    with path.open(newline="") as file:
        return {(row["box"], row["figure"]): float(row["mean"]) for row in csv.DictReader(file)}


@pytest.fixture(scope="module", params=BOXES)
def box(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def heights(box: str) -> tuple[np.ndarray, np.ndarray]:
    """Grounds and ceilings (n, 200) of uniform tasks of a box, in m above their starts."""
    theta = np.random.default_rng(1).uniform(*np.transpose(BOXES[box]), size=(TASKS, 3))
    curves = CPPN.load().curves(theta.astype(np.float32)).astype(np.float64)
    ground, ceiling = np.moveaxis((curves - curves[:, :1]) / DELTA, -1, 0)
    return ground, ceiling


@pytest.mark.parametrize("height", ["2.7", "5"])
def test_as_many_tasks_leave_room_to_pass(
    height: str, box: str, heights: tuple[np.ndarray, np.ndarray], release
) -> None:
    ground, ceiling = heights
    clearance = (ceiling - ground).min(axis=1) + 200 / DELTA
    expected = release[box, f"share_of_tasks_with_smallest_clearance_above_{height}"]
    error = np.sqrt(expected * (1 - expected) / TASKS)
    assert np.mean(clearance > float(height)) == pytest.approx(expected, abs=0.05 + 2 * error)


def test_grounds_are_as_steep_and_reach_as_far(
    box: str, heights: tuple[np.ndarray, np.ndarray], release
) -> None:
    ground, _ = heights
    slope = np.abs(np.diff(ground, axis=1)).mean() / STEP
    assert slope == pytest.approx(release[box, "mean_slope"], rel=0.2)
    assert np.ptp(ground, axis=1).mean() == pytest.approx(release[box, "ground_range"], rel=0.2)


def test_tracks_start_at_the_same_heights(release) -> None:
    for outline, figure in zip(
        outlines(np.zeros(3, np.float32), DELTA, CPPN.load()),
        ("ground_at_start", "ceiling_at_start"),
        strict=True,
    ):
        assert outline[STARTPAD_STEPS] == pytest.approx(release["all", figure], abs=1e-4)
