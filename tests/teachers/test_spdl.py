from __future__ import annotations

import numpy as np
import pytest
from simulated_play import SPACES, play, started

from tma_ray.tasks import Episode, KnowledgeLevel, Query, QueryKind
from tma_ray.teachers import effective_level, make_teacher
from tma_ray.teachers.spdl import LARGEST_PENALTY, MOST_CONTEXTS, SPDL

STUMP_TRACKS = SPACES["stump_tracks"]


def spdl(level: KnowledgeLevel = KnowledgeLevel.HIGH, space: str = "stump_tracks", **changes: float) -> SPDL:
    teacher = started("spdl", SPACES[space], level=level, **changes)
    assert isinstance(teacher, SPDL)
    return teacher


def end(teacher: SPDL, step: int, discounted_return: float = 50.0) -> Query | None:
    task = teacher.sample()
    observation = np.append(task, step).astype(np.float32)
    return teacher.observe(Episode(task, 0.0, False, 10, observation, discounted_return, step))


def learn(teacher: SPDL, discounted_return: float = 50.0) -> dict[str, float]:
    """End episodes until an update, answers with flat values, and return what it logged."""
    teacher.drain_updates()
    query, step = None, teacher.next_update_ - 400
    while query is None:
        step += 20
        query = end(teacher, step, discounted_return)
    assert query.observations is not None
    teacher.answer(np.full(len(query.observations), 40.0))
    return teacher.drain_updates()[0].scalars


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
    assert query is not None
    assert query.kind is QueryKind.STATE_VALUES
    assert query.observations is not None
    assert query.observations[:, 2].tolist() == list(range(5001 - MOST_CONTEXTS, 5001))
    teacher.answer(np.zeros(MOST_CONTEXTS))
    assert end(teacher, 5040) is None
    query = end(teacher, 5050)
    assert query is not None
    assert query.observations is not None
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
    assert scalars[-1]["target_divergence"] < 1e-9
    assert scalars[-1]["alpha"] == LARGEST_PENALTY
    tasks = STUMP_TRACKS.normalise(teacher.probe(2000))
    np.testing.assert_allclose(tasks.mean(axis=0), 0.5, atol=0.03)
    np.testing.assert_allclose(tasks.std(axis=0), 0.24, atol=0.02)  # a quarter, less what is clipped


def test_it_goes_where_values_are_high() -> None:
    teacher = spdl(KnowledgeLevel.NONE, penalty_share=0.01)
    before = teacher.probe(200).mean(axis=0)
    for _ in range(6):
        query, step = None, teacher.next_update_ - 4000
        while query is None:
            step += 20
            query = end(teacher, step)
        assert query.observations is not None
        teacher.answer(10.0 * query.observations[:, 0])  # higher stumps are worth more
    after = teacher.probe(200).mean(axis=0)
    assert after[0] > before[0] + 0.5
    assert abs(after[1] - before[1]) < abs(after[0] - before[0])


def test_it_starts_at_the_initial_gaussian() -> None:
    informed = spdl(KnowledgeLevel.HIGH)
    gaussian = informed.drain_updates()[0].gaussians[0]
    np.testing.assert_allclose(gaussian.mean, informed.knowledge.initial.mean)
    np.testing.assert_allclose(gaussian.covariance, np.diag(informed.knowledge.initial.variance))
    placed = spdl(KnowledgeLevel.LOW)
    np.testing.assert_allclose(
        placed.drain_updates()[0].gaussians[0].mean, placed.knowledge.initial.mean, rtol=1e-6
    )
    assert not np.allclose(placed.knowledge.initial.mean, informed.knowledge.initial.mean)
    assert effective_level(SPDL, "spdl", KnowledgeLevel.LOW) is KnowledgeLevel.NONE


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


@pytest.mark.parametrize(
    "wrong",
    [
        {"first_update": -1},
        {"update_every": 0},
        {"updates_without_penalty": -1},
        {"penalty_share": -0.1},
        {"most_divergence": 0.0},
    ],
)
def test_impossible_hyperparameters_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        make_teacher("spdl", wrong)
