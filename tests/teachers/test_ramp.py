"""Ramp: where the Gaussian is at each step."""

from __future__ import annotations

import numpy as np
import pytest
from simulated_play import EPISODE_LENGTH, SPACES, play, started

from tma_ray.teachers import make_teacher


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


def test_a_way_without_steps_is_refused() -> None:
    with pytest.raises(ValueError, match="steps = 0: expected at least 1"):
        make_teacher("ramp", {"steps": 0})
