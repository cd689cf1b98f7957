"""Sobol: evenness of its tasks, in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from simulated_play import SPACES, play, started

from tma_ray.tasks import TaskSpace
from tma_ray.teachers import make_teacher


@pytest.mark.parametrize("columns", [256, 64, 16, 4, 1])
def test_every_box_of_equal_volume_holds_one_of_the_first_tasks(columns: int) -> None:
    """Two dimensions are a (0, m, 2)-net: so are the next 256 points."""
    points = SPACES["stump_tracks"].normalise(np.stack(play(started("sobol", SPACES["stump_tracks"]), 512)))
    for block in (points[:256], points[256:]):
        rows = 256 // columns
        boxes = (np.floor(block[:, 0] * columns) * rows + np.floor(block[:, 1] * rows)).astype(int)
        assert np.bincount(boxes, minlength=256).tolist() == [1] * 256


def test_constants_stay_and_every_dimension_is_even() -> None:
    space = SPACES["with_constants"]
    tasks = np.stack(play(started("sobol", space), 256))
    assert set(tasks[:, 1]) == {10.0}
    for column in (0, 2):
        intervals = np.floor(space.normalise(tasks)[:, column] * 256)
        assert sorted(intervals) == list(range(256))


def test_a_probe_shows_what_comes_next() -> None:
    teacher = started("sobol", SPACES["stump_tracks"])
    play(teacher, 250)
    np.testing.assert_array_equal(teacher.probe(300), np.stack(play(teacher, 300, step=250)))


def test_a_space_without_width_is_refused() -> None:
    space = TaskSpace.from_bounds({"a": (1, 1)})
    with pytest.raises(ValueError, match="nothing to choose"):
        make_teacher("sobol").start(space, None, np.random.default_rng(0))  # type: ignore[arg-type]
