"""SFL: what it asks, and which tasks it keeps."""

import numpy as np
import pytest
from simulated_play import SPACES, ended, started

from tma_ray.tasks import KnowledgeLevel, Outcomes, Query, QueryKind
from tma_ray.teachers.sfl import SFL

SPACE = SPACES["stump_tracks"]


def sfl(**settings: object) -> SFL:
    return started("sfl", SPACE, level=KnowledgeLevel.LOW, **settings)


def asked(teacher: SFL, shares: list[float]) -> Query | None:
    """Play an episode; master each task that is asked for as often as `shares` says."""
    query = teacher.observe(ended(teacher.propose().task))
    if query is not None:
        count = teacher.rollouts
        successes = np.concatenate([np.arange(count) < round(share * count) for share in shares])
        teacher.answer(Outcomes(np.where(successes, 300.0, 0.0), successes, np.full(len(query.tasks), 10)))
    return query


def test_it_asks_for_several_episodes_of_each_task_now_and_then() -> None:
    teacher = sfl(candidates=5, rollouts=4, refresh_every=7)
    queries = [asked(teacher, [0] * 5) for _ in range(22)]
    assert [index for index, query in enumerate(queries) if query] == [0, 7, 14, 21]
    for query in filter(None, queries):
        assert query.kind is QueryKind.EVALUATION
        assert not query.greedy
        assert len(np.unique(query.tasks, axis=0)) == 5
        np.testing.assert_array_equal(query.tasks[::4], query.tasks[3::4])


def test_the_tasks_of_highest_learnability_are_kept() -> None:
    teacher = sfl(candidates=6, rollouts=4, kept=3, buffer_share=1.0)
    candidates = asked(teacher, [0, 0.25, 1, 0.5, 0.75, 0.5]).tasks[::4]
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
    teacher = sfl(candidates=6, rollouts=4)
    asked(teacher, [0, 1, 0, 1, 0, 1])
    tasks = SPACE.normalise(np.stack([teacher.propose().task for _ in range(2000)]))
    np.testing.assert_allclose(tasks.mean(axis=0), 0.5, atol=0.03)
    (update,) = teacher.drain_updates()
    assert update.gaussians == ()


def test_sizes_are_scaled_by_the_square_root_of_the_budget() -> None:
    teacher = sfl(candidates=50, kept=20, rollouts=2, refresh_every=100, budget=200_000)
    queries = [asked(teacher, [0.5] * 5) for _ in range(31)]
    sizes = {index: len(query.tasks) for index, query in enumerate(queries) if query}
    assert sizes == dict.fromkeys((0, 10, 20, 30), 10)
    assert len(teacher.buffer_) == 2
