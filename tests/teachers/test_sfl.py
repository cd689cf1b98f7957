"""SFL: what it asks, and which tasks it keeps."""

from __future__ import annotations

import numpy as np
import pytest
from simulated_play import SPACES, ended

from tma_ray.tasks import KnowledgeLevel, Outcomes, Query, QueryKind, Task, expert_knowledge
from tma_ray.teachers import make_teacher
from tma_ray.teachers.sfl import SFL

SPACE = SPACES["stump_tracks"]


def started(**settings: object) -> SFL:
    teacher = make_teacher("sfl", settings)
    assert isinstance(teacher, SFL)
    knowledge = expert_knowledge(KnowledgeLevel.LOW, SPACE, np.random.default_rng(1))
    teacher.start(SPACE, knowledge, np.random.default_rng(0))
    return teacher


def observed(teacher: SFL) -> Query | None:
    task = teacher.propose().task
    return teacher.observe(ended(task))


def answer(tasks: Task, shares: list[float], rollouts: int) -> Outcomes:
    """Masters each task as often as `shares` says."""
    successes = np.concatenate([np.arange(rollouts) < round(share * rollouts) for share in shares])
    return Outcomes(np.where(successes, 300.0, 0.0), successes, np.full(len(tasks), 10))


def test_it_asks_for_several_episodes_of_each_task_now_and_then() -> None:
    teacher = started(candidates=5, rollouts=4, refresh_every=7)
    asked = []
    for index in range(22):
        query = observed(teacher)
        if query is not None:
            assert query.kind is QueryKind.EVALUATION
            assert query.tasks is not None
            assert not query.greedy
            assert len(np.unique(query.tasks, axis=0)) == 5
            np.testing.assert_array_equal(query.tasks[::4], query.tasks[3::4])
            teacher.answer(answer(query.tasks, [0, 0, 0, 0, 0], 4))
            asked.append(index)
    assert asked == [0, 7, 14, 21]


def test_the_tasks_of_highest_learnability_are_kept() -> None:
    teacher = started(candidates=6, rollouts=4, kept=3, buffer_share=1.0)
    query = observed(teacher)
    assert query is not None
    assert query.tasks is not None
    teacher.answer(answer(query.tasks, [0, 0.25, 1, 0.5, 0.75, 0.5], 4))
    candidates = query.tasks[::4]
    kept = {tuple(task) for task in teacher.buffer_}
    assert {tuple(candidates[3]), tuple(candidates[5])} < kept
    assert len(kept & {tuple(candidates[1]), tuple(candidates[4])}) == 1
    assert {tuple(teacher.propose().task) for _ in range(100)} == kept
    assert {tuple(task) for task in teacher.probe(100)} == kept
    (update,) = teacher.drain_updates()
    assert update.scalars == {
        "buffer_size": 3.0,
        "mean_learnability": pytest.approx((2 * 3 / 16 + 2 / 4) / 6),
        "mastered_share": pytest.approx(0.5),
    }


def test_tasks_are_uniform_while_nothing_can_be_learned() -> None:
    teacher = started(candidates=6, rollouts=4)
    query = observed(teacher)
    assert query is not None
    assert query.tasks is not None
    teacher.answer(answer(query.tasks, [0, 1, 0, 1, 0, 1], 4))
    tasks = SPACE.normalise(np.stack([teacher.propose().task for _ in range(2000)]))
    np.testing.assert_allclose(tasks.mean(axis=0), 0.5, atol=0.03)
    (update,) = teacher.drain_updates()
    assert update.gaussians == ()


def test_sizes_are_scaled_by_the_square_root_of_the_budget() -> None:
    teacher = started(candidates=50, kept=20, rollouts=2, refresh_every=100, budget=200_000)
    asked = []
    for index in range(31):
        query = observed(teacher)
        if query is not None:
            assert query.tasks is not None
            teacher.answer(answer(query.tasks, [0.5] * 5, 2))
            asked.append((index, len(query.tasks), len(teacher.buffer_)))
    assert asked == [(index, 2 * 5, 2) for index in (0, 10, 20, 30)]
