"""PERM: simulated abilities and difficulties are recovered, and tasks suit the ability."""

import numpy as np
import pytest
from simulated_play import SPACES, ended, started

from tma_ray.teachers.perm import ResponseModel

SPACE = SPACES["stump_tracks"]


def difficulty(tasks: np.ndarray) -> np.ndarray:
    points = SPACE.normalise(tasks)
    return np.asarray(4 * (points[..., 0] - 0.5) + 2 * np.sin(3 * points[..., 1]) - 1.33)


def test_simulated_abilities_and_difficulties_are_recovered() -> None:
    rng = np.random.default_rng(0)
    abilities, weights = np.linspace(-2, 2, 9), np.array([1.5, -1.0, 0.5])
    features = rng.normal(size=(9 * 400, 3))
    windows = np.repeat(np.arange(9), 400)
    chances = 1 / (1 + np.exp(features @ weights - abilities[windows]))
    drawn = rng.random(len(chances)) < chances
    for responses, tolerance in ((drawn.astype(float), 0.3), (chances, 0.12)):
        found_abilities, found_weights = ResponseModel().fit(features, windows, responses)
        np.testing.assert_allclose(found_abilities, abilities, atol=tolerance)
        np.testing.assert_allclose(found_weights, weights, atol=tolerance / 2)


def test_the_fit_is_the_mode_of_the_posterior() -> None:
    rng = np.random.default_rng(1)
    features, windows = rng.normal(size=(60, 2)), np.repeat(np.arange(3), 20)
    responses = rng.random(60)
    model = ResponseModel(2.0, 0.7, 1.5)

    def log_posterior(abilities: np.ndarray, weights: np.ndarray) -> float:
        chances = 1 / (1 + np.exp(features @ weights - abilities[windows]))
        likelihood = (responses * np.log(chances) + (1 - responses) * np.log(1 - chances)).sum()
        prior = (abilities[0] / 2.0) ** 2 + (np.diff(abilities) ** 2).sum() / 0.7**2
        return float(likelihood - (prior + (weights**2).sum() / 1.5**2) / 2)

    best = model.fit(features, windows, responses)
    for index in range(5):
        for step in (-1e-3, 1e-3):
            moved = np.concatenate(best)
            moved[index] += step
            assert log_posterior(moved[:3], moved[3:]) < log_posterior(*best)


def test_tasks_are_as_difficult_as_the_student_is_able() -> None:
    teacher = started("perm", SPACE, window_episodes=150, windows=6, explore=0.3)
    rng = np.random.default_rng(2)
    for ability in np.linspace(-1.5, 1.0, 8).repeat(150):
        task = teacher.propose().task
        succeeds = rng.random() < 1 / (1 + np.exp(difficulty(task) - ability))
        teacher.observe(ended(task, 350.0 if succeeds else -150.0, succeeds))
    tasks = SPACE.sample(rng, 1000)
    found = teacher.difficulty(tasks)
    assert np.corrcoef(found, difficulty(tasks))[0, 1] > 0.95
    assert found.mean() == pytest.approx(0, abs=0.1)
    assert teacher.ability_ == pytest.approx(1.0, abs=0.5)
    chosen = difficulty(teacher.probe(200))
    assert np.abs(chosen - 1.0).mean() < 0.6
    assert np.abs(difficulty(tasks) - 1.0).mean() > 1.2
    updates = teacher.drain_updates()
    assert len(updates) == 8
    assert updates[-1].scalars["ability"] > updates[1].scalars["ability"] + 1
