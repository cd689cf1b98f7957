"""DORAEMON: Beta distributions in closed form, updates against a search, and a slope too steep to master."""

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import check_grad
from simulated_play import SPACES, ended, started

from tma_ray.tasks import KnowledgeLevel
from tma_ray.teachers.doraemon import DORAEMON, BetaProduct, EntropyUpdate

ONE = BetaProduct(np.array([3.0, 1.0]), np.array([5.0, 2.5]))
OTHER = BetaProduct(np.array([1.2, 4.0]), np.array([2.0, 9.0]))


def test_moments_and_densities_are_scipys() -> None:
    parts = [stats.beta(a, b) for a, b in zip(*ONE, strict=True)]
    np.testing.assert_allclose(ONE.mean, [part.mean() for part in parts])
    np.testing.assert_allclose(ONE.variance, [part.var() for part in parts])
    assert ONE.entropy()[0] == pytest.approx(sum(part.entropy() for part in parts))
    points = np.random.default_rng(0).random((5, 2))
    expected = [sum(part.logpdf(x) for part, x in zip(parts, point, strict=True)) for point in points]
    np.testing.assert_allclose(ONE.log_densities(points)[0], expected)


def test_the_divergence_is_the_integral() -> None:
    grid = (np.arange(20_000) + 0.5) / 20_000
    expected = 0.0
    for pair in zip(*ONE, *OTHER, strict=True):
        one, other = stats.beta(*pair[:2]), stats.beta(*pair[2:])
        expected += float((one.pdf(grid) * (one.logpdf(grid) - other.logpdf(grid))).mean())
    assert ONE.divergence(OTHER)[0] == pytest.approx(expected, rel=1e-3)
    assert ONE.divergence(ONE)[0] == pytest.approx(0, abs=1e-12)


def test_gradients_are_differences() -> None:
    rng = np.random.default_rng(0)
    points = ONE.draw(rng, 30)
    update = EntropyUpdate(ONE, points, points[:, 0] < 0.4, 0.5, 0.1, 100.0)
    for function in (update.entropy, update.success, update.room):
        error = check_grad(lambda x, f=function: f(x)[0], lambda x, f=function: f(x)[1], OTHER.logs)
        assert error < 1e-5


@pytest.mark.parametrize("least_success", [0.0001, 0.8])
def test_an_update_finds_what_a_search_finds(least_success: float) -> None:
    present = BetaProduct(np.array([20.0]), np.array([30.0]))
    points = present.draw(np.random.default_rng(1), 200)
    update = EntropyUpdate(present, points, points[:, 0] < 0.45, least_success, 0.05, 200.0)
    found = update.solved()
    logs = np.stack(np.meshgrid(*[np.linspace(np.log(5), np.log(60), 60)] * 2), axis=-1).reshape(-1, 2)
    near = [each for each in logs if update.room(each)[0] >= 0 and update.success(each)[0] >= least_success]
    best = max(update.entropy(each)[0] for each in near)
    assert found.entropy()[0] >= best - 1e-6
    assert update.room(found.logs)[0] >= -2e-4
    assert update.success(found.logs)[0] >= least_success - 2e-4


def test_without_a_feasible_distribution_success_is_sought() -> None:
    present = BetaProduct(np.array([20.0]), np.array([20.0]))
    points = present.draw(np.random.default_rng(1), 200)
    update = EntropyUpdate(present, points, points[:, 0] < 0.4, 0.99, 0.05, 200.0)
    found = update.solved()
    assert found.mean[0] < present.mean[0] - 0.02
    assert update.success(found.logs)[0] > 1.5 * update.success(present.logs)[0]


def taught(limit: float, updates: int = 30, episodes: int = 40, **settings: float) -> DORAEMON:
    """Play `episodes` per update of which those are mastered whose first coordinate is at most `limit`."""
    teacher = doraemon(update_every=10 * episodes, **settings)
    learn(teacher, limit, episodes * updates, 10)
    return teacher


def doraemon(level: KnowledgeLevel = KnowledgeLevel.HIGH, **settings: float) -> DORAEMON:
    return started("doraemon", SPACES["with_constants"], level=level, easy_task=[0.2, 10, 0], **settings)


def learn(teacher: DORAEMON, limit: float, episodes: int, steps: int) -> None:
    """Play episodes of `steps`, mastered where the first coordinate is at most `limit`."""
    for index in range(episodes):
        task = teacher.sample()
        teacher.observe(ended(task, 0.0, bool(task[0] <= limit), steps * (index + 1)))


def test_the_mode_is_at_first_the_initial_task() -> None:
    teacher = taught(1.0, updates=0)
    points = teacher.probe(4_000)[:, [0, 2]] / np.array([1, 10]) + np.array([0, 0.5])
    np.testing.assert_allclose(points.mean(axis=0), [0.203, 0.5], atol=0.005)
    np.testing.assert_allclose(points.std(axis=0), [0.0284, 0.0353], atol=0.003)


def test_a_student_that_masters_everything_gets_uniform_tasks() -> None:
    distribution = taught(1.0).distribution_
    assert distribution.entropy()[0] > -0.01


@pytest.mark.parametrize("share", [0.5, 0.8])
def test_the_share_of_mastered_tasks_is_kept(share: float) -> None:
    """As in the authors' toy, a slope that is too steep from some angle on."""
    teacher = taught(0.3, episodes=150, least_success=share)
    tasks = teacher.probe(4_000)
    assert (tasks[:, 0] <= 0.3).mean() == pytest.approx(share, abs=0.1)
    assert np.std(tasks[:, 2]) > 2.5, "what makes no difference becomes uniform"


def test_nothing_changes_before_the_share_is_reached() -> None:
    teacher = taught(-1.0, updates=3)
    first = taught(-1.0, updates=0).distribution_
    np.testing.assert_array_equal(np.stack(teacher.distribution_), np.stack(first))


@pytest.mark.parametrize(("level", "is_wide"), [(KnowledgeLevel.LOW, True), (KnowledgeLevel.HIGH, False)])
def test_without_an_easy_task_it_can_start_uniform_and_narrow(level: KnowledgeLevel, is_wide: bool) -> None:
    teacher = doraemon(level, start_from_wide_uniform=True, budget=20_000)
    assert (teacher.distribution_.entropy()[0] == 0.0) == is_wide
    if is_wide:
        assert teacher.next_update_ == 3162  # of 100,000, for a thousandth of the paper's budget
        learn(teacher, 0.1, 1500, 20)
        assert (teacher.probe(2_000)[:, 0] <= 0.1).mean() > 0.3
