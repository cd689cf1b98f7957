"""Mixtures against scikit-learn's, and the teachers that draw tasks from them: ALP-GMM and Covar-GMM."""

import pickle

import numpy as np
import pytest
from simulated_play import SPACES, ended, play, started
from sklearn.mixture import GaussianMixture
from threadpoolctl import threadpool_limits

from tma_ray.tasks import KnowledgeLevel, TaskSpace
from tma_ray.teachers.alp_gmm import ALPGMM, AbsoluteLearningProgress, NearestReturn
from tma_ray.teachers.covar_gmm import CovarGMM
from tma_ray.teachers.mixtures import Mixture, fit_mixture, units_of

STUMP_TRACKS = SPACES["stump_tracks"]


@pytest.mark.parametrize(("columns", "most_components"), [(1, 6), (3, 6), (9, 3)])
def test_a_fit_is_the_one_of_scikit_learn_with_the_lowest_aic(columns: int, most_components: int) -> None:
    rng = np.random.default_rng(columns)
    centres = rng.uniform(0, 10, (3, columns)) * ([1] * (columns - 1) + [30])
    parts = [rng.normal(centre, 1 + index, (40, columns)) for index, centre in enumerate(centres)]
    rows = np.concatenate(parts)
    with threadpool_limits(limits=1):
        fits = [GaussianMixture(size, random_state=7).fit(rows) for size in range(2, most_components + 1)]
        best = min(fits, key=lambda fit: fit.aic(rows))
    mixture = fit_mixture(rows, most_components, seed=7)
    np.testing.assert_allclose(mixture.weights, best.weights_, rtol=1e-9)
    np.testing.assert_allclose(mixture.means, best.means_, rtol=1e-9)
    np.testing.assert_allclose(mixture.covariances, best.covariances_, rtol=1e-7, atol=1e-9)


def test_rows_that_coincide_are_fitted_and_can_be_drawn_from() -> None:
    rows = np.tile([1.0, 2.0, 300.0], (150, 1))
    mixture = fit_mixture(rows, 10, seed=0)
    drawn = [mixture.draw(index, np.random.default_rng(0)) for index in range(len(mixture))]
    assert any(np.allclose(point, rows[0], atol=0.01) for point in drawn)


@pytest.mark.parametrize("name", ["alp_gmm", "covar_gmm"])
def test_the_width_of_the_space_does_not_matter(name: str) -> None:
    """Beyond the widths of units of 1, tasks of a space that is 2^k times as wide are 2^k times as large."""
    probes = []
    for power in (-30, -10, 20, 40):
        space = TaskSpace.from_bounds({"a": (0, 3 * 2.0**power), "b": (0, 5 * 2.0**power)})
        teacher = started(name, space, level=KnowledgeLevel.LOW, fit_every=30)
        play(teacher, 200)
        probes.append(teacher.probe(50) / np.float32(2.0**power))
    for probe in probes:
        np.testing.assert_array_equal(probe, probes[0])
        assert np.all(probe.std(axis=0) < 0.4 * np.array([3, 5]))  # 0.5 if all lie in corners


def test_units_are_one_between_the_widths_of_the_benchmark() -> None:
    widths = np.array([0.0, 2.0**-6, 0.5, 1000.0, 2.0**12, 1e6, 1e-4])
    np.testing.assert_array_equal(units_of(widths), [1, 1, 1, 1, 1, 2.0**20, 2.0**-13])


def test_nearest_return_equals_a_search_through_everything() -> None:
    rng = np.random.default_rng(0)
    history, tasks, returns = NearestReturn(2, rebuild_every=50), [], []
    for index in range(230):
        task = rng.random(2).astype(np.float32)
        if tasks:
            distances = np.linalg.norm(np.array(tasks) - task, axis=1)
            assert history.nearest(task) == returns[int(np.argmin(distances))]
        if index == 120:
            history = pickle.loads(pickle.dumps(history))
        tasks.append(task.astype(np.float64))
        returns.append(float(rng.normal()))
        history.add(task, returns[-1])


def test_progress_is_the_absolute_difference_once_six_tasks_are_known() -> None:
    progress = AbsoluteLearningProgress(1)
    tasks = [np.array([x], np.float32) for x in (0, 1, 2, 3, 4, 5)]
    assert [progress(task, 10.0) for task in tasks] == [0.0] * 6
    assert progress(np.array([2.1], np.float32), -30.0) == 40.0


def test_components_are_chosen_in_proportion_to_their_mean_progress() -> None:
    teacher = started("alp_gmm", STUMP_TRACKS, explore=0.0)
    tiny = np.tile(np.eye(3) * 1e-8, (3, 1, 1))
    means = np.array([[0.5, 1.0, 30.0], [1.5, 3.0, 10.0], [2.5, 5.0, 0.0]])
    teacher.mixture_ = Mixture(np.full(3, 1 / 3), means, tiny)
    np.testing.assert_allclose(shares_of_heights(teacher, 0.5, 1.5, 2.5), [0.75, 0.25, 0.0], atol=0.03)
    means[:, -1] = 0.0
    np.testing.assert_allclose(shares_of_heights(teacher, 0.5, 1.5, 2.5), [1 / 3] * 3, atol=0.04)


def shares_of_heights(teacher: ALPGMM | CovarGMM, *heights: float) -> np.ndarray:
    """Return the share of tasks whose height is next to each of `heights`."""
    drawn = np.array([teacher.sample()[0] for _ in range(4000)])
    return (np.abs(drawn - np.array(heights)[:, None]) < 0.1).mean(axis=1)


@pytest.mark.parametrize("name", ["alp_gmm", "covar_gmm"])
def test_bootstrap_is_uniform_unless_the_expert_knows_where_to_start(name: str) -> None:
    uniform = np.stack(play(started(name, STUMP_TRACKS, level=KnowledgeLevel.LOW), 150))
    informed = np.stack(play(started(name, STUMP_TRACKS, level=KnowledgeLevel.HIGH), 150))
    assert uniform[:, 0].mean() == pytest.approx(1.5, abs=0.25)
    assert informed[:, 0].max() < 1.2  # the easy task is the lower corner, its std a tenth of the range


def test_it_follows_progress_and_logs_every_fit() -> None:
    teacher = started("alp_gmm", STUMP_TRACKS, level=KnowledgeLevel.NONE, most_components=5)
    for index in range(900):  # only low stumps can be learned
        task = teacher.sample()
        learnable = float(task[0]) < 1.0
        gain = 0.5 * index if learnable else 0.0
        teacher.observe(ended(task, -100 + gain))
    updates = teacher.drain_updates()
    assert len(updates) == 6
    assert all(2 <= len(update.gaussians) <= 5 for update in updates)
    assert np.mean(teacher.probe(200)[:, 0] < 1.2) > 0.6


def covar_gmm(level: KnowledgeLevel = KnowledgeLevel.NONE, **settings: object) -> CovarGMM:
    return started("covar_gmm", STUMP_TRACKS, level=level, **settings)


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
        teacher.observe(ended(tasks[-1], 3.0 * index))
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
    for progress, wanted in (("absolute", np.abs(expected)), ("positive", [expected[0], 0.0])):
        found = covar_gmm(progress=progress).progress_of(mixture)[order]
        np.testing.assert_allclose(found, wanted, rtol=1e-6)


@pytest.mark.parametrize(
    ("progress", "expected"), [("absolute", [0.5, 0.125, 0.375]), ("positive", [0.8, 0.2, 0.0])]
)
def test_components_are_chosen_in_proportion_to_progress(progress: str, expected: list[float]) -> None:
    teacher = covar_gmm(progress=progress, explore=0.0)
    teacher.mixture_ = with_covariances(40.0, 10.0, -30.0)
    np.testing.assert_allclose(shares_of_heights(teacher, 0, 1, 2), expected, atol=0.03)


def test_one_task_in_ten_is_uniform() -> None:
    teacher = covar_gmm()
    teacher.mixture_ = with_covariances(0.0, 10.0)
    (share,) = shares_of_heights(teacher, 1)
    assert share == pytest.approx(0.9 + 0.1 * 0.2 / 3, abs=4 * np.sqrt(0.09 / 4000))
    assert np.abs(teacher.probe(1000)[:, 0] - 1).max() < 0.01


@pytest.mark.slow
def test_it_follows_forgetting_too_and_logs_every_fit() -> None:
    teacher = covar_gmm()
    for index in range(900):  # low stumps are forgotten, the others stay as they are
        task = teacher.sample()
        teacher.observe(ended(task, 200 - 0.3 * index if task[0] < 1 else -100.0))
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
