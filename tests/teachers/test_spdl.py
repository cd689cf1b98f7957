"""SPDL: its schedule, and its updates of a Gaussian against textbook formulas and searches."""

from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from simulated_play import SPACES, play, started

from tma_ray.tasks import Episode, KnowledgeLevel, Query, QueryKind
from tma_ray.teachers.spdl import LARGEST_PENALTY, MOST_CONTEXTS, SPDL, FullGaussian, self_paced_update

STUMP_TRACKS = SPACES["stump_tracks"]


def spdl(level: KnowledgeLevel = KnowledgeLevel.HIGH, space: str = "stump_tracks", **changes: float) -> SPDL:
    return started("spdl", SPACES[space], level=level, **changes)


def end(teacher: SPDL, step: int, discounted_return: float = 50.0) -> Query | None:
    task = teacher.sample()
    observation = np.append(task, step).astype(np.float32)
    return teacher.observe(Episode(task, 0.0, False, 10, observation, discounted_return, step))


def learn(teacher: SPDL, discounted_return: float = 50.0) -> dict[str, float]:
    """End episodes until an update, answers with flat values, and return what it logged."""
    teacher.drain_updates()
    query = asked(teacher, 400, discounted_return)
    teacher.answer(np.full(len(query.observations), 40.0))
    return teacher.drain_updates()[0].scalars


def asked(teacher: SPDL, ahead: int, discounted_return: float = 50.0) -> Query:
    """End an episode every 20 steps, from `ahead` steps before an update on, and return what it asks."""
    steps = range(teacher.next_update_ - ahead + 20, teacher.next_update_ + 20, 20)
    *others, query = [end(teacher, step, discounted_return) for step in steps]
    assert others == [None] * len(others)
    return query


def test_an_update_is_due_at_the_first_episode_end_after_its_step() -> None:
    teacher = spdl(first_update=1000, update_every=500)
    asked = []
    for step in [*range(130, 2500, 130), 9001, 9131, 9510]:
        query = end(teacher, step)
        if query is not None:
            asked.append(step)
            teacher.answer(np.zeros(len(query.observations)))
    assert asked == [1040, 1560, 2080, 9001, 9510]


def test_it_asks_for_the_values_of_the_episodes_since_the_last_update() -> None:
    teacher = spdl(first_update=5000, update_every=50)
    for step in range(1, 5000):
        assert end(teacher, step) is None
    query = end(teacher, 5000)
    assert query.kind is QueryKind.STATE_VALUES
    assert query.observations[:, 2].tolist() == list(range(5001 - MOST_CONTEXTS, 5001))
    teacher.answer(np.zeros(MOST_CONTEXTS))
    assert end(teacher, 5040) is None
    query = end(teacher, 5050)
    assert query.observations[:, 2].tolist() == [5040, 5050]


def test_alpha_keeps_the_penalty_a_share_of_the_mean_discounted_return() -> None:
    teacher = spdl(penalty_share=0.2)
    divergence = teacher.drain_updates()[0].scalars["target_divergence"]
    scalars = learn(teacher, discounted_return=30.0)
    assert scalars["alpha"] * divergence == pytest.approx(0.2 * 30)
    assert scalars["mean_discounted_return"] == pytest.approx(30)
    assert scalars["mean_value"] == pytest.approx(40)
    assert 0 < scalars["step_divergence"] <= 0.8
    assert scalars["target_divergence"] < divergence


def test_without_success_or_before_its_time_there_is_no_penalty() -> None:
    assert learn(spdl(), discounted_return=-5.0)["alpha"] == 0
    delayed = spdl(updates_without_penalty=2)
    alphas = [learn(delayed)["alpha"] for _ in range(3)]
    assert alphas[:2] == [0, 0]
    assert alphas[2] > 0


def test_flat_values_lead_to_the_target_and_keep_it_there() -> None:
    teacher = spdl()
    scalars = [learn(teacher) for _ in range(15)]
    assert np.all(np.diff([each["target_divergence"] for each in scalars]) <= 1e-12)
    assert scalars[-1]["target_divergence"] < 1e-9
    assert scalars[-1]["alpha"] == LARGEST_PENALTY
    tasks = STUMP_TRACKS.normalise(teacher.probe(2000))
    np.testing.assert_allclose(tasks.mean(axis=0), 0.5, atol=0.03)
    np.testing.assert_allclose(tasks.std(axis=0), 0.24, atol=0.02)  # a quarter, less what is clipped


def test_it_goes_where_values_are_high() -> None:
    teacher = spdl(KnowledgeLevel.NONE, penalty_share=0.01)
    before = teacher.probe(200).mean(axis=0)
    for _ in range(6):
        query = asked(teacher, 4000)
        noise = np.random.default_rng(0).normal(0, 1, len(query.observations))
        teacher.answer(10.0 * query.observations[:, 0] + noise)  # higher stumps are worth more
    after = teacher.probe(200).mean(axis=0)
    assert after[0] > before[0] + 0.5
    assert abs(after[1] - before[1]) < abs(after[0] - before[0])


def test_it_starts_at_the_initial_gaussian() -> None:
    informed, placed = spdl(KnowledgeLevel.HIGH), spdl(KnowledgeLevel.LOW)
    for teacher in (informed, placed):
        gaussian = teacher.drain_updates()[0].gaussians[0]
        np.testing.assert_allclose(gaussian.mean, teacher.knowledge.initial.mean, rtol=1e-6)
        np.testing.assert_allclose(gaussian.covariance, np.diag(teacher.knowledge.initial.variance))
    assert not np.allclose(placed.knowledge.initial.mean, informed.knowledge.initial.mean)


def test_constant_dimensions_keep_their_value_and_variance() -> None:
    teacher = spdl(space="with_constants")
    tasks = np.stack(play(teacher, 300))
    assert np.all(tasks[:, 1] == 10)
    updates = teacher.drain_updates()
    assert len(updates) > 3
    for update in updates:
        gaussian = update.gaussians[0]
        assert gaussian.mean[1] == 10
        assert gaussian.covariance[1].tolist() == [0, teacher.knowledge.initial.variance[1], 0]


def random_gaussian(size: int, rng: np.random.Generator, spread: float = 0.3) -> FullGaussian:
    factor = np.tril(spread * rng.normal(size=(size, size)) / np.sqrt(size), -1)
    np.fill_diagonal(factor, spread * np.exp(0.3 * rng.normal(size=size)))
    return FullGaussian(rng.random(size), factor)


def density(gaussian: FullGaussian, points: np.ndarray) -> np.ndarray:
    normal = multivariate_normal(gaussian.mean, gaussian.factor @ gaussian.factor.T)
    return np.exp(normal.logpdf(points).reshape(-1))


def objective(new: FullGaussian, old: FullGaussian, target: FullGaussian, *task: Any) -> float:
    points, values, alpha = task
    weights = np.exp(new.seen_from(old).log_ratio(old.whiten(points)))
    return float(np.mean(weights * (values - values.mean()))) - alpha * new.divergence(target)


@pytest.mark.parametrize("size", [1, 2, 7])
def test_divergence_equals_the_textbook_and_a_sample_mean(size: int) -> None:
    rng = np.random.default_rng(size)
    one, other = random_gaussian(size, rng), random_gaussian(size, rng)
    first, second = one.factor @ one.factor.T, other.factor @ other.factor.T
    shift, precision = other.mean - one.mean, np.linalg.inv(second)
    log_determinants = np.linalg.slogdet(second)[1] - np.linalg.slogdet(first)[1]
    expected = (np.trace(precision @ first) + shift @ precision @ shift - size + log_determinants) / 2
    assert one.divergence(other) == pytest.approx(expected, rel=1e-10)
    points = one.draw(rng, 100_000)
    sample = np.log(density(one, points) / density(other, points))
    assert one.divergence(other) == pytest.approx(sample.mean(), abs=5 * sample.std() / np.sqrt(len(points)))


def test_coordinates_and_back() -> None:
    rng = np.random.default_rng(0)
    gaussian, frame = random_gaussian(3, rng), random_gaussian(3, rng)
    back = gaussian.seen_from(frame).placed_in(frame)
    np.testing.assert_allclose(back.mean, gaussian.mean, rtol=1e-12)
    np.testing.assert_allclose(back.factor, gaussian.factor, rtol=1e-12)
    points = rng.normal(size=(20, 3))
    ratio = density(gaussian, points) / density(FullGaussian(np.zeros(3), np.eye(3)), points)
    np.testing.assert_allclose(np.exp(gaussian.log_ratio(points)), ratio, rtol=1e-9)


@pytest.mark.parametrize("bound", [0.01, 0.8, 3.0])
@pytest.mark.parametrize("size", [1, 2, 20])
def test_every_update_gains_and_keeps_within_the_bound(size: int, bound: float) -> None:
    rng = np.random.default_rng(size)
    for alpha in (0.0, 0.5, 50.0):
        old, target = random_gaussian(size, rng), random_gaussian(size, rng, 0.5)
        points = np.clip(old.draw(rng, 250), 0, 1)
        values = 100 * points.sum(axis=1) + rng.normal(0, 10, len(points))
        new = self_paced_update(old, target, points, values, alpha, bound)
        assert 0 < old.divergence(new) <= bound
        assert np.all(np.diag(new.factor) > 0)
        before, after = (objective(each, old, target, points, values, alpha) for each in (old, new))
        assert after > before


def test_a_short_step_is_the_steepest() -> None:
    """Of all distributions at the same small divergence none has a larger objective."""
    rng = np.random.default_rng(3)
    old, target = random_gaussian(2, rng), random_gaussian(2, rng)
    points = old.draw(rng, 300)
    values, alpha, bound = 30 * np.sin(4 * points).sum(axis=1), 5.0, 1e-5
    new = self_paced_update(old, target, points, values, alpha, bound)
    start, best = (objective(each, old, target, points, values, alpha) for each in (old, new))
    others = []
    for _ in range(300):
        factor = np.eye(2) + np.tril(rng.normal(size=(2, 2))) * 3e-3
        other = FullGaussian(3e-3 * rng.normal(size=2), factor).placed_in(old)
        # So near, gain and root of the divergence are linear: the gain is scaled to the bound.
        gain = objective(other, old, target, points, values, alpha) - start
        others.append(gain * np.sqrt(bound / old.divergence(other)))
    gained = best - start
    assert gained > 0
    assert 0.9 * gained < max(others) < 1.02 * gained


def test_nothing_to_gain_changes_nothing() -> None:
    rng = np.random.default_rng(0)
    old, target = random_gaussian(2, rng), random_gaussian(2, rng)
    assert self_paced_update(old, target, old.draw(rng, 50), np.full(50, -7.0), 0.0, 0.8) is old
