import itertools
from dataclasses import replace

import numpy as np
import pytest

from tma_ray.testing import SimulatedStudent, StudentParameters
from tma_ray.testing.students import DISCOUNT, EPISODE_STEPS

STEADY = StudentParameters(pace_spread=0.0)
EASY, HARD = [0, 6], [3, 0]  # of Stump Tracks: height and spacing


def student(aptitude: StudentParameters = STEADY, seed: int = 0) -> SimulatedStudent:
    return SimulatedStudent(EASY, HARD, np.random.default_rng(seed), aptitude)


def trained(episodes: int = 3000, aptitude: StudentParameters = STEADY) -> SimulatedStudent:
    learner, rng = student(aptitude), np.random.default_rng(1)
    for height, spacing in rng.random((episodes, 2)) * [1.5, 6]:
        learner.play([height, spacing])
    return learner


class Loop:
    """The equations of the module's docstring, region by region."""

    def __init__(self, size: int, aptitude: StudentParameters) -> None:
        self.aptitude, axis = aptitude, [(i + 0.5) / aptitude.regions for i in range(aptitude.regions)]
        self.centres = [np.array(centre) for centre in itertools.product(axis, repeat=size)]
        self.competences = [0.0] * len(self.centres)

    def kernel(self, q: np.ndarray) -> list[float]:
        ell = self.aptitude.reach / self.aptitude.regions
        return [float(np.exp(-np.sum((q - centre) ** 2) / (2 * ell**2))) for centre in self.centres]

    def competence(self, q: np.ndarray) -> float:
        if max(q) > 1 or np.mean(q) > self.aptitude.limit:
            return 0.0
        weights = self.kernel(q)
        return sum(w * k for w, k in zip(weights, self.competences, strict=True)) / sum(weights)

    def play(self, q: np.ndarray) -> None:
        a, weights = self.aptitude, self.kernel(q)
        easier = np.maximum(q - a.zone, 0)
        readiness = 1.0 if max(q) <= a.zone else self.competence(easier)
        feasible = max(q) <= 1 and np.mean(q) <= a.limit
        for i, centre in enumerate(self.centres):
            if feasible:
                pace = a.pace * max(1 - np.mean(centre) / a.limit, 0)
                self.competences[i] += pace * readiness * weights[i] * (1 - self.competences[i])
            self.competences[i] *= 1 - a.forgetting


@pytest.mark.parametrize("size", [1, 2, 3])
def test_it_follows_its_equations(size: int) -> None:
    aptitude = replace(STEADY, pace=0.5, regions=5, zone=0.3, forgetting=0.01)
    learner = SimulatedStudent(np.zeros(size), np.ones(size), np.random.default_rng(0), aptitude)
    loop, rng = Loop(size, aptitude), np.random.default_rng(2)
    for q in (1.1 * rng.random((80, size)) ** 2).astype(np.float32):  # mostly easy
        learner.play(q)
        loop.play(q.astype(np.float64))
    tests = (rng.random((40, size)) ** 2).astype(np.float32)
    expected = [-100 + 400 * loop.competence(q.astype(np.float64)) for q in tests]
    np.testing.assert_allclose(learner.expected_returns(tests), expected, rtol=1e-9)
    assert max(expected) > 0


def test_nothing_is_learned_beyond_the_zone_of_proximal_development() -> None:
    for task, teaches in (([0.2, 5.8], True), ([0.8, 4.0], False), ([2.9, 6.0], False)):
        learner = student()
        for _ in range(50):
            learner.play(task)
        assert bool(np.any(learner.expected_returns([task]) > -100)) is teaches


def test_what_was_too_hard_teaches_once_its_easier_neighbours_are_mastered() -> None:
    learner, task = student(), [0.5, 5.5]
    before = learner.expected_returns([task])[0]
    learner.play(task)
    assert learner.expected_returns([task])[0] == before == -100
    for _ in range(200):
        learner.play([0.1, 5.9])
    known = learner.expected_returns([task])[0]
    for _ in range(50):
        learner.play(task)
    assert learner.expected_returns([task])[0] > known + 50


def test_a_mastered_task_teaches_nothing_more() -> None:
    learner = student(replace(STEADY, forgetting=0.0))
    gains = []
    for _ in range(4):
        before = learner.expected_returns([[0, 6]])[0]
        for _ in range(100):
            learner.play([0, 6])
        gains.append(learner.expected_returns([[0, 6]])[0] - before)
    assert gains == sorted(gains, reverse=True)
    assert gains[0] > 10 * gains[-1]


def test_unfeasible_tasks_are_hopeless_and_competence_fades_meanwhile() -> None:
    learner = trained()
    before = learner.expected_returns([[0.5, 5]])[0] + 100
    unfeasible = [[3.5, 6], [9, 6], [2.5, 1.0]]
    returns = [learner.play(unfeasible[index % 3]) for index in range(600)]
    assert np.mean(returns) == pytest.approx(-100, abs=1.5)
    assert np.std(returns) == pytest.approx(8, abs=1)
    np.testing.assert_array_equal(learner.expected_returns(unfeasible), -100)
    after = learner.expected_returns([[0.5, 5]])[0] + 100
    assert after == pytest.approx(before * (1 - STEADY.forgetting) ** 600)


def test_returns_scatter_around_what_is_expected() -> None:
    learner = trained(aptitude=replace(STEADY, forgetting=0.0))
    learner._pace = np.zeros_like(learner._pace)  # from now on only examined
    tests = [[0.2, 5.5], [1.0, 4.0], [1.2, 3.0]]
    for task, expected in zip(tests, learner.expected_returns(tests), strict=True):
        returns = np.array([learner.play(task) for _ in range(1000)])
        competence = (expected + 100) / 400
        assert returns.mean() == pytest.approx(expected, abs=5)
        assert returns.std() == pytest.approx(400 * (0.02 + 0.4 * competence * (1 - competence)), rel=0.1)


def test_values_are_expected_discounted_returns() -> None:
    learner, tasks = trained(), [[0.2, 5.5], [1.0, 4.0], [3, 0]]
    per_step = learner.expected_returns(tasks)[:, None] / EPISODE_STEPS
    expected = np.sum(per_step * DISCOUNT ** np.arange(EPISODE_STEPS), axis=1)
    np.testing.assert_allclose(learner.state_values(learner.initial_observations(tasks)), expected)


def test_what_is_easier_than_the_easiest_counts_as_the_easiest() -> None:
    learner = trained()
    observations = learner.initial_observations([[-2, 7], [0, 6]])
    np.testing.assert_array_equal(observations, [[0, 0], [0, 0]])
    assert observations.dtype == np.float32


def test_no_two_students_are_alike_and_one_seed_is_one_student() -> None:
    returns = []
    for seed in (0, 0, 1):
        learner = SimulatedStudent(EASY, HARD, np.random.default_rng(seed))
        for _ in range(20):
            learner.play([0, 6])
        returns.append(float(learner.expected_returns([[0, 6]])[0]))
    assert returns[0] == returns[1] != returns[2]


def test_it_learns_in_six_dimensions_too() -> None:
    aptitude = replace(STEADY, regions=4, zone=0.3, pace=0.3)
    learner = SimulatedStudent(np.zeros(6), np.ones(6), np.random.default_rng(0), aptitude)
    for q in np.random.default_rng(1).random((1000, 6)):
        learner.play(0.5 * q)
    assert learner.expected_returns([np.full(6, 0.2)])[0] > 100
