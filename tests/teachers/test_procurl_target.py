"""ProCuRL-Target: the score of its paper on a grid, and the tasks that it chooses."""

import itertools

import numpy as np
from simulated_play import SPACES, play, started

from tma_ray.teachers.procurl_target import proximity, similarity


def test_the_best_task_is_that_of_the_formula_on_a_grid() -> None:
    axis = np.linspace(0, 1, 15)
    grid = np.array(list(itertools.product(axis, axis)))
    targets = np.array([[0.9, 0.2], [0.5, 0.9], [1.0, 1.0]])

    def value(point: np.ndarray) -> float:
        return float(np.exp(-2.5 * point[0] - 1.5 * point[1]))

    def open_share(point: np.ndarray) -> float:
        return value(point) * (1 - value(point))

    def alike(point: np.ndarray, target: np.ndarray) -> float:
        return float(np.exp(-np.hypot(*(point - target)) / 0.25))

    scores = [open_share(x) * max(open_share(y) * alike(x, y) for y in targets) for x in grid]
    values, target_values = (np.array([value(point) for point in points]) for points in (grid, targets))
    found = proximity(values, target_values, similarity(grid, targets, 0.25))
    np.testing.assert_allclose(found, scores, rtol=1e-12)
    assert found.argmax() == np.argmax(scores)
    assert found.argmax() not in (values.argmax(), values.argmin())


def test_tasks_neither_too_easy_nor_too_hard_are_chosen() -> None:
    space = SPACES["stump_tracks"]
    teacher = started("procurl_target", space, first_update=40_000, update_every=10_000_000)
    np.testing.assert_allclose(space.normalise(teacher.probe(2000)).mean(axis=0), 0.5, atol=0.04)
    play(teacher, 400)
    expected = 300 - 400 * space.normalise(teacher.probe(500)).mean(axis=1) + 0.2 * 200
    assert np.abs(expected - 100).mean() < 60  # value 1/2
    uniform = 300 - 400 * space.normalise(space.sample(np.random.default_rng(0), 500)).mean(axis=1) + 40
    assert np.abs(expected - 100).mean() < 0.8 * np.abs(uniform - 100).mean()
    assert len(teacher.drain_updates()) == 1


def test_waits_are_scaled_by_the_square_root_of_the_budget() -> None:
    settings = {"first_update": 1_000, "update_every": 2_000, "pool_size": 20, "budget": 200_000}
    teacher = started("procurl_target", SPACES["line"], **settings)
    pools = []
    for step in range(10):  # of 100 steps: updates after 100, 300, 500, 700 and 900
        play(teacher, 1, step)
        pools.append(teacher.pool_.tobytes())
    assert len(teacher.drain_updates()) == 5
    assert [pools.index(pool) for pool in pools] == [0, 0, 2, 2, 2, 2, 6, 6, 6, 6]
