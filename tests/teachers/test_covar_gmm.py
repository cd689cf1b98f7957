from __future__ import annotations

import numpy as np
import pytest
from simulated_play import SPACES, started

from tma_ray.tasks import Episode, KnowledgeLevel, Task
from tma_ray.teachers import effective_level, make_teacher
from tma_ray.teachers.covar_gmm import CovarGMM
from tma_ray.teachers.mixtures import Mixture, fit_mixture

STUMP_TRACKS = SPACES["stump_tracks"]


def covar_gmm(level: KnowledgeLevel = KnowledgeLevel.NONE) -> CovarGMM:
    teacher = started("covar_gmm", STUMP_TRACKS, level=level)
    assert isinstance(teacher, CovarGMM)
    return teacher


def episode(task: Task, episodic_return: float) -> Episode:
    return Episode(task, episodic_return, False, 10, np.zeros(1, np.float32), 0.0, 0)


def with_covariances(*covariances: float) -> Mixture:
    """One tight component per height 0, 1, 2... whose time and return covary as given."""
    means = np.array([[height, 3.0, 0.5, 0.0] for height in range(len(covariances))])
    blocks = np.tile(np.diag([1e-8, 1e-8, 0.1, 1e5]), (len(covariances), 1, 1))
    blocks[:, 2, 3] = blocks[:, 3, 2] = covariances
    return Mixture(np.full(len(covariances), 1 / len(covariances)), means, blocks)


def test_rows_hold_the_task_its_time_in_the_batch_and_its_return() -> None:
    teacher = covar_gmm()
    tasks = []
    for index in range(200):
        tasks.append(teacher.sample())
        teacher.observe(episode(tasks[-1], 3.0 * index))
    rows = np.array(teacher.recent_)
    np.testing.assert_array_equal(rows[:, :2], np.array(tasks[50:], dtype=np.float64))
    np.testing.assert_allclose(rows[:, 2], np.arange(50, 200) % 150 / 150)
    np.testing.assert_array_equal(rows[:, 3], 3.0 * np.arange(50, 200))


def test_progress_is_the_covariance_of_time_and_return_among_a_components_rows() -> None:
    rng = np.random.default_rng(0)
    time = np.arange(60) / 60
    learning = np.column_stack([rng.normal([0, 0], 0.1, (60, 2)), time, 90 * time + rng.normal(0, 5, 60)])
    forgetting = np.column_stack([rng.normal([3, 6], 0.1, (60, 2)), time, 2000 - 40 * time])
    mixture = fit_mixture(np.concatenate([learning, forgetting]), 2, seed=0)
    order = np.argsort(mixture.means[:, 0])
    expected = [np.cov(rows[:, 2], rows[:, 3], bias=True)[0, 1] for rows in (learning, forgetting)]
    assert expected[0] > 0 > expected[1]
    absolute = CovarGMM().progress_of(mixture)[order]
    positive = make_teacher("covar_gmm", {"progress": "positive"}).progress_of(mixture)[order]
    np.testing.assert_allclose(absolute, np.abs(expected), rtol=1e-6)
    np.testing.assert_allclose(positive, [expected[0], 0.0], rtol=1e-6)


@pytest.mark.parametrize(
    ("progress", "expected"), [("absolute", [0.5, 0.125, 0.375]), ("positive", [0.8, 0.2, 0.0])]
)
def test_components_are_chosen_in_proportion_to_progress(progress: str, expected: list[float]) -> None:
    teacher = make_teacher("covar_gmm", {"progress": progress, "explore": 0.0})
    teacher.start(STUMP_TRACKS, covar_gmm().knowledge, np.random.default_rng(3))
    teacher.mixture_ = with_covariances(40.0, 10.0, -30.0)
    heights = np.array([teacher.sample()[0] for _ in range(4000)])
    shares = [np.mean(np.abs(heights - height) < 0.1) for height in range(3)]
    np.testing.assert_allclose(shares, expected, atol=0.03)


def test_one_task_in_ten_is_uniform() -> None:
    teacher = covar_gmm()
    teacher.mixture_ = with_covariances(0.0, 10.0)
    heights = np.array([teacher.sample()[0] for _ in range(4000)])
    assert np.mean(np.abs(heights - 1) > 0.01) == pytest.approx(0.1, abs=4 * np.sqrt(0.09 / 4000))
    assert np.abs(teacher.probe(1000)[:, 0] - 1).max() < 0.01


@pytest.mark.slow
def test_it_follows_forgetting_too_and_logs_every_fit() -> None:
    teacher = covar_gmm()
    for index in range(900):  # low stumps are forgotten, the others stay as they are
        task = teacher.sample()
        teacher.observe(episode(task, 200 - 0.3 * index if task[0] < 1 else -100.0))
    updates = teacher.drain_updates()
    assert len(updates) == 6
    for update in updates:
        assert 2 <= len(update.gaussians) <= 15
        assert update.scalars["components"] == len(update.gaussians)
    latest = teacher.mixture_
    progress = np.abs(latest.covariances[:, -2, -1])
    logged = [component.weight for component in updates[-1].gaussians]
    np.testing.assert_allclose(logged, progress / progress.sum())
    assert updates[-1].scalars["mean_progress"] == pytest.approx(latest.weights @ progress)
    assert updates[-1].scalars["largest_progress"] == progress.max()
    assert np.mean(teacher.probe(200)[:, 0] < 1.2) > 0.8


def test_only_high_knowledge_changes_the_bootstrap() -> None:
    teacher = covar_gmm(KnowledgeLevel.HIGH)
    informed = np.stack([teacher.sample() for _ in range(200)])
    assert informed[:, 0].max() < 1.2  # the easy task is the lower corner, its std a tenth of the range
    assert effective_level(CovarGMM, "covar_gmm", KnowledgeLevel.LOW) is KnowledgeLevel.NONE


@pytest.mark.parametrize("wrong", [{"fit_every": 2}, {"most_components": 1}, {"progress": "relative"}])
def test_impossible_hyperparameters_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        make_teacher("covar_gmm", wrong)
