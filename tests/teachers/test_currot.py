"""CURROT: assignments, moves and successes in closed form, and a line whose end is out of reach."""

import numpy as np
import pytest
from simulated_play import SPACES, ended, started

from tma_ray.tasks import KnowledgeLevel
from tma_ray.teachers.currot import Performance, SuccessBuffer, assigned, moved

RNG = np.random.default_rng(0)
EVERYWHERE = Performance(np.array([[0.5, 0.5]]), np.array([300.0]), 0.1)
RADIUS = 0.1


def test_on_a_line_the_optimal_assignment_keeps_the_order() -> None:
    sources, targets = RNG.random((2, 40, 1))
    order = assigned(sources, targets)
    np.testing.assert_array_equal(np.argsort(sources[:, 0]), np.argsort(targets[order, 0]))


def test_expected_returns_are_weighted_by_the_kernel() -> None:
    performance = Performance(np.array([[0.0], [1.0]]), np.array([10.0, 20.0]), width=0.5)
    weight = np.exp(-0.5 * (0.25**2 - 0.75**2) / 0.5**2)
    expected = [15.0, (10 * weight + 20) / (weight + 1), 10.0]
    np.testing.assert_allclose(performance(np.array([[0.5], [0.25], [-30.0]])), expected, rtol=1e-5)


def test_particles_go_straight_where_they_may() -> None:
    particles, targets = RNG.random((2, 60, 2))
    there = moved(particles, targets, EVERYWHERE, 180.0, RADIUS, np.random.default_rng(1))
    before, after = (np.linalg.norm(each - targets, axis=1) for each in (particles, there))
    np.testing.assert_allclose(after, np.maximum(before - 0.1, 0), atol=1e-9)


def test_no_particle_goes_where_returns_are_too_low() -> None:
    grid = np.linspace(0, 1, 201)[:, None]
    performance = Performance(grid, np.where(grid[:, 0] < 0.5, 300.0, 0.0), 0.01)
    particles, ends = np.random.default_rng(2).uniform(0, 0.45, (50, 1)), np.ones((50, 1))
    for step in range(20):
        particles = moved(particles, ends, performance, 180.0, RADIUS, np.random.default_rng(step))
    assert (particles > 0.45).all()
    assert (particles < 0.51).all()
    lost = moved(np.full((5, 1), 0.55), ends[:5], performance, 180.0, RADIUS, np.random.default_rng(3))
    assert (lost < 0.5).all(), "the best return in reach"


def buffer_after(*batches: list[float], capacity: int = 6, least: float = 10.0) -> SuccessBuffer:
    """Add tasks that lie where their return says, in tenths of 1 / 10."""
    buffer = SuccessBuffer(1, capacity, least)
    targets = np.linspace(0, 1, capacity)[:, None]
    for batch in batches:
        buffer.add(np.array(batch)[:, None] / 100, np.array(batch), targets)
    return buffer


def test_before_mastery_the_better_half_stays() -> None:
    buffer = buffer_after([1.0, 2.0, 3.0, 4.0], [2.0, 5.0, 6.0])
    assert sorted(buffer.returns) == [3.0, 4.0, 5.0, 6.0]
    assert not buffer.reached
    points = buffer.draw(np.random.default_rng(0), 4_000, 0.0)
    assert points.std() == pytest.approx(0.25 * 4.6 / 9, abs=0.06), "noise grows with what is missing"


def test_mastered_tasks_stay_where_targets_are() -> None:
    buffer = buffer_after([11.0, 12.0, 13.0, 14.0], [9.0, 15.0], [32.0, 50.0, 52.0, 70.0, 98.0])
    assert buffer.reached
    assert len(buffer.returns) == 6
    assert {32.0, 98.0, 70.0} < set(buffer.returns), "targets are spread over the whole line"
    assert buffer.returns.min() >= 10
    points = buffer.draw(np.random.default_rng(0), 12, 0.0)
    np.testing.assert_array_equal(np.unique(points), np.unique(buffer.points))


def test_what_is_left_out_is_told() -> None:
    buffer = buffer_after([11.0, 12.0, 13.0, 14.0])
    left_out = buffer.add(np.array([[0.2], [0.3]]), np.array([5.0, 20.0]), np.linspace(0, 1, 6)[:, None])
    assert left_out.tolist() == [True, False]


@pytest.mark.parametrize("level", [KnowledgeLevel.LOW, KnowledgeLevel.HIGH])
def test_the_curriculum_covers_what_can_be_mastered_and_no_more(level: KnowledgeLevel) -> None:
    teacher, tasks = started("currot", SPACES["line"], level=level, particles=60, update_every=30), []
    for index in range(1500):
        task = teacher.sample()
        gained = 300.0 if task[0] < 0.2 else 0.0
        tasks.append(task[0])
        teacher.observe(ended(task, gained, gained > 230, 10 * index))
    if level is KnowledgeLevel.HIGH:
        assert np.quantile(tasks[:30], 0.9) < -0.6, "it starts from easy tasks"
    late = np.array(tasks[-500:])
    assert (late < 0.25).mean() > 0.9
    assert np.histogram(late, bins=6, range=(-1, 0.2))[0].min() > 20
    if level is KnowledgeLevel.LOW:
        return
    distances = [update.scalars["target_distance"] for update in teacher.drain_updates()]
    assert distances[-1] < distances[0]
