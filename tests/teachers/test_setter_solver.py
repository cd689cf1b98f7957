from functools import cache

import numpy as np
import pytest
import torch
from simulated_play import SPACES, ended, started

from tma_ray.tasks import KnowledgeLevel, TeacherUpdate
from tma_ray.teachers.setter_solver import SetterSolver

STUMP_TRACKS = SPACES["stump_tracks"]


def setter_solver(**changes: float) -> SetterSolver:
    return started("setter_solver", STUMP_TRACKS, level=KnowledgeLevel.LOW, **changes)


@cache
def taught(updates: int = 80) -> tuple[SetterSolver, list[TeacherUpdate]]:
    """A teacher whose student masters the lower half of all stumps, whatever their distance."""
    teacher = setter_solver(hidden_units=16, learning_rate=3e-3, update_every=50)
    for _ in range(50 * updates):
        task = teacher.sample()
        teacher.observe(ended(task, success=bool(task[0] < 1.5)))
    return teacher, teacher.drain_updates()


@pytest.mark.slow
def test_the_judge_separates_what_the_student_can_from_what_it_cannot() -> None:
    teacher, updates = taught()
    easy, hard = np.random.default_rng(0).random((2, 200, 2)) * [0.45, 1] + np.array([[[0, 0]], [[0.55, 0]]])
    with torch.no_grad():
        judged = [teacher.judge_(torch.from_numpy(points))[:, 0].numpy() for points in (easy, hard)]
    assert np.mean(judged[0] > 0) > 0.9
    assert np.mean(judged[1] < 0) > 0.9
    losses = [update.scalars["judge_loss"] for update in updates]
    assert np.mean(losses[-20:]) < 0.7 * np.mean(losses[:5])


@pytest.mark.slow
def test_the_setter_proposes_tasks_as_feasible_as_asked_and_spreads() -> None:
    teacher, _ = taught()
    latents = torch.from_numpy(np.random.default_rng(0).standard_normal((300, 2)))
    asked = [torch.full((300,), feasibility, dtype=torch.float64) for feasibility in (0.97, 0.03)]
    with torch.no_grad():
        easy, hard = (teacher.setter_(latents, each)[0].numpy() for each in asked)
    assert np.mean(easy[:, 0] < 0.5) > 0.8
    assert np.mean(hard[:, 0] > 0.5) > 0.8
    spacings = STUMP_TRACKS.normalise(teacher.probe(500))[:, 1]
    assert spacings.std() > 0.15


@pytest.mark.slow
def test_both_get_better_for_longer() -> None:
    _, updates = taught(150)
    for name, share in (("judge_loss", 0.5), ("feasibility_loss", 0.7)):
        losses = [update.scalars[name] for update in updates]
        assert np.mean(losses[-20:]) < share * np.mean(losses[:5])


def test_what_was_solved_becomes_likely() -> None:
    """Without judge and spread in the way: the validity loss alone falls."""
    teacher = setter_solver(hidden_units=16, learning_rate=3e-3)
    for _ in range(15 * teacher.update_every):
        task = teacher.sample()
        teacher.observe(ended(task, success=bool(np.all(STUMP_TRACKS.normalise(task) < 0.5))))
    losses = [update.scalars["validity_loss"] for update in teacher.drain_updates()]
    assert np.mean(losses[-3:]) < np.mean(losses[:3]) - 0.3


def test_a_batch_without_success_leaves_validity_out() -> None:
    teacher = setter_solver(update_every=10)
    for _ in range(30):
        teacher.observe(ended(teacher.sample(), success=False))
    updates = teacher.drain_updates()
    assert len(updates) == 3
    for update in updates:
        assert update.scalars.keys() == {"success_share", "judge_loss", "feasibility_loss", "coverage_loss"}
        assert all(np.isfinite(value) for value in update.scalars.values())
    assert all(torch.isfinite(weight).all() for weight in teacher.setter_.parameters())
    for _ in range(10):
        teacher.observe(ended(teacher.sample(), success=True))
    assert "validity_loss" in teacher.drain_updates()[0].scalars


def test_networks_change_every_so_many_episodes_only() -> None:
    teacher = setter_solver(update_every=20)
    before = [weight.clone() for weight in teacher.setter_.parameters()]

    def changed() -> bool:
        pairs = zip(before, teacher.setter_.parameters(), strict=True)
        return any(not torch.equal(one, other) for one, other in pairs)

    for _ in range(19):
        teacher.observe(ended(teacher.sample(), success=True))
    assert not changed()
    teacher.observe(ended(teacher.sample(), success=True))
    assert changed()
