"""Teachers without feedback, Ramp and Sobol, in closed form; the unit box of a space."""

import numpy as np
import pytest
from simulated_play import EPISODE_LENGTH, SPACES, play, started

from tma_ray.tasks import TaskSpace
from tma_ray.teachers.numerics import UnitBox


@pytest.mark.parametrize(("episodes", "share"), [(0, 0.0), (50, 0.5), (100, 1.0), (130, 1.0)])
def test_the_gaussian_moves_in_proportion_to_the_steps(episodes: int, share: float) -> None:
    space = SPACES["stump_tracks"]
    teacher = started("ramp", space, steps=100 * EPISODE_LENGTH)
    play(teacher, episodes)
    tasks = teacher.probe(20_000).astype(float)
    mean = share * np.array([1.5, 3.0])
    deviation = ((1 - share) * 0.1 + share * 0.25) * np.array([3.0, 6.0])
    rng = np.random.default_rng(1)
    expected = np.clip(rng.normal(mean, deviation, (200_000, 2)), space.low, space.high)
    np.testing.assert_allclose(tasks.mean(axis=0), expected.mean(axis=0), atol=0.03)
    np.testing.assert_allclose(tasks.std(axis=0), expected.std(axis=0), atol=0.03)
    (gaussian,) = teacher.drain_updates()[-1].gaussians
    if episodes in (0, 100):
        np.testing.assert_allclose(gaussian.mean, mean, atol=1e-9)
        np.testing.assert_allclose(gaussian.covariance, np.diag(deviation**2), atol=1e-9)


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


def test_only_dimensions_with_width_are_chosen() -> None:
    with pytest.raises(ValueError, match="there is nothing to choose"):
        UnitBox(TaskSpace.from_bounds({"fixed": (3, 3)}))
    box = UnitBox(SPACES["with_constants"])
    assert box.size == 2
    np.testing.assert_allclose(box.normalise([[0.25, 10, 5]]), [[0.25, 1.0]])
    tasks = box.denormalise(np.array([[0.5, 0.5], [-1.0, 2.0]]))
    assert tasks.tolist() == [[0.5, 10, 0], [0, 10, 5]]
    assert tasks.dtype == np.float32
    assert box.denormalise(np.array([1.0, 0.0])).tolist() == [1, 10, -5]
