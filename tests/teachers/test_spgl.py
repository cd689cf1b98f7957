"""SPGL: its closed form against a numerical optimum, and where it goes."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize
from simulated_play import SPACES, play, started

from tma_ray.tasks import Episode
from tma_ray.teachers.spdl import FullGaussian
from tma_ray.teachers.spgl import closed_form_update, quadratic_fit

Array = NDArray[np.float64]
CURRENT = FullGaussian(np.array([0.2, 0.3]), np.array([[0.1, 0.0], [0.04, 0.15]]))
TARGET = FullGaussian(np.array([0.5, 0.5]), np.diag([0.25, 0.2]))


def divergence(one: tuple[Array, Array], other: tuple[Array, Array]) -> float:
    """Return KL(one || other) of Gaussians by mean and covariance."""
    (mean, covariance), (other_mean, other_covariance) = one, other
    inverse, apart = np.linalg.inv(other_covariance), other_mean - mean
    determinants = np.linalg.slogdet(other_covariance)[1] - np.linalg.slogdet(covariance)[1]
    return float((np.trace(inverse @ covariance) + apart @ inverse @ apart - len(mean) + determinants) / 2)


def moments(gaussian: FullGaussian) -> tuple[Array, Array]:
    return gaussian.mean, gaussian.factor @ gaussian.factor.T


def unpacked(numbers: Array) -> tuple[Array, Array]:
    """Return mean and covariance of two means, and of a factor with a diagonal of logarithms."""
    factor = np.array([[np.exp(numbers[2]), 0.0], [numbers[3], np.exp(numbers[4])]])
    return numbers[:2], factor @ factor.T


RETURNS: dict[str, Callable[[Array], Array]] = {
    "hill": lambda x: 200 - 900 * ((x - [0.4, 0.1]) ** 2).sum(axis=1),
    "slope": lambda x: 100 + 300 * x[:, 0] - 150 * x[:, 1],
    "valley": lambda x: 900 * (x[:, 0] - 0.2) ** 2 - 50 * x[:, 1],
    "flat": lambda x: np.full(len(x), 70.0),
}


@pytest.mark.parametrize("penalty", [0.0, 8.0])
@pytest.mark.parametrize("shape", RETURNS)
def test_an_update_is_the_numerical_optimum_of_its_objective(shape: str, penalty: float) -> None:
    bound = 0.3
    contexts = CURRENT.draw(np.random.default_rng(0), 400)
    returns = RETURNS[shape](contexts)
    gradient, curvature = quadratic_fit(CURRENT.whiten(contexts), returns)

    def loss(numbers: Array) -> float:
        mean, covariance = unpacked(numbers)
        whitened = CURRENT.whiten(mean[None])[0]
        inverse = np.linalg.inv(CURRENT.factor)
        second = inverse @ covariance @ inverse.T + np.outer(whitened, whitened)
        expected = gradient @ whitened + (curvature * second).sum() / 2
        return (penalty * divergence((mean, covariance), moments(TARGET)) - float(expected)) / 10

    def room(numbers: Array) -> float:
        return bound - divergence(unpacked(numbers), moments(CURRENT))

    logs = np.log(np.diag(CURRENT.factor))
    start = np.array([*CURRENT.mean, logs[0], CURRENT.factor[1, 0], logs[1]])
    constraint = {"type": "ineq", "fun": room}
    bounds = [(number - 1.5, number + 1.5) for number in start]
    options = {"maxiter": 500, "ftol": 1e-13}
    best = minimize(loss, start, bounds=bounds, constraints=[constraint], options=options)
    assert best.success
    found = closed_form_update(CURRENT, TARGET, contexts, returns, penalty, bound)
    mean, covariance = moments(found)
    assert divergence((mean, covariance), moments(CURRENT)) <= bound * (1 + 1e-6)
    factor = found.factor
    numbers = np.array([*mean, np.log(factor[0, 0]), factor[1, 0], np.log(factor[1, 1])])
    scale = max(1.0, abs(best.fun))
    assert loss(numbers) <= best.fun + 1e-4 * scale
    if shape != "flat" or penalty:
        np.testing.assert_allclose(mean, unpacked(best.x)[0], atol=2e-3)
        np.testing.assert_allclose(covariance, unpacked(best.x)[1], atol=2e-3)


def test_without_a_bound_equal_returns_lead_to_the_target_at_once() -> None:
    contexts = CURRENT.draw(np.random.default_rng(0), 50)
    found = closed_form_update(CURRENT, TARGET, contexts, np.full(50, 30.0), 2.0, 1e3)
    for one, other in zip(moments(found), moments(TARGET), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6)


def test_it_walks_from_the_easy_corner_to_the_target_as_returns_rise() -> None:
    teacher = started("spgl", SPACES["stump_tracks"], first_update=3_000, update_every=3_000)
    before = teacher.probe(500).mean(axis=0)
    play(teacher, 1500)
    after = teacher.probe(500).mean(axis=0)
    updates = teacher.drain_updates()
    divergences = [update.scalars["target_divergence"] for update in updates]
    assert divergences[-1] < 0.2 * divergences[0]
    assert (after > before).all()
    assert max(update.scalars.get("step_divergence", 0.0) for update in updates) <= 0.2 * (1 + 1e-6)


def test_it_does_not_shrink_to_a_point_on_the_best_of_hopeless_tasks() -> None:
    """Returns below 0 leave no penalty that would pull it to the target."""
    teacher = started("spgl", SPACES["stump_tracks"], first_update=1, update_every=1)
    for step in range(0, 3_000, 40):
        tasks = teacher.probe(40)
        teacher.tasks_ = list(tasks[:-1])
        teacher.returns_ = [-500 - 100 * float(((task - 1) ** 2).sum()) for task in tasks[:-1]]
        teacher.observe(Episode(tasks[-1], -500.0, False, 40, np.zeros(1, np.float32), 0.0, step + 40))
    assert np.linalg.svd(teacher.distribution_.factor)[1].min() >= 0.99e-3
