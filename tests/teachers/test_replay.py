"""PLR, robust PLR and ACCEL: scores, the buffer, and what is played when."""

from dataclasses import replace

import numpy as np
import pytest
import simulated_play
from simulated_play import ended

from tma_ray.tasks import KnowledgeLevel, Proposal, QueryKind, TaskSpace, Trajectory
from tma_ray.teachers import canonical_teacher, hyperparameters_of, make_teacher
from tma_ray.teachers.prioritised_replay import (
    PrioritisedReplay,
    TaskBuffer,
    negative_advantage,
    positive_value_loss,
)

SPACE = TaskSpace.from_bounds({"height": (0, 3), "fixed": (7, 7), "gap": (0, 6)})


def trajectory(rewards: list[float], terminated: bool, gamma: float = 0.9) -> Trajectory:
    steps = len(rewards)
    observations, actions = np.zeros((steps + 1, 1), np.float32), np.zeros((steps, 1), np.float32)
    return Trajectory(observations, actions, np.array(rewards), terminated, gamma)


@pytest.mark.parametrize("terminated", [False, True])
@pytest.mark.parametrize("gae_lambda", [0.0, 0.7, 1.0])
def test_the_positive_value_loss_is_the_recursion_written_out(terminated: bool, gae_lambda: float) -> None:
    rng = np.random.default_rng(0)
    rewards, values = rng.normal(size=12).tolist(), rng.normal(size=13)
    advantage, total = 0.0, 0.0
    for step in reversed(range(12)):
        following = 0.0 if terminated and step == 11 else values[step + 1]
        advantage = rewards[step] + 0.9 * following - values[step] + 0.9 * gae_lambda * advantage
        total += max(advantage, 0.0)
    score = positive_value_loss(trajectory(rewards, terminated), values, gae_lambda)
    assert score == pytest.approx(total / 12, rel=1e-12)


@pytest.mark.parametrize("terminated", [False, True])
@pytest.mark.parametrize("gae_lambda", [0.0, 0.7, 1.0])
def test_the_negative_advantage_is_its_formula_written_out(terminated: bool, gae_lambda: float) -> None:
    rng = np.random.default_rng(0)
    rewards, values = rng.normal(size=9).tolist(), rng.normal(size=10)
    following = [*values[1:9], 0.0 if terminated else values[9]]
    errors = [rewards[step] + 0.9 * following[step] - values[step] for step in range(9)]
    total = 0.0
    for first in range(9):
        cut, left = 0.0, 9 - first
        for ahead in range(left):
            cut = min(0.0, cut + 0.9**ahead * errors[first + ahead])
            weight = gae_lambda**ahead * (1 if ahead == left - 1 else 1 - gae_lambda)
            total -= weight * cut
    score = negative_advantage(trajectory(rewards, terminated), values, gae_lambda)
    assert score == pytest.approx(total / 9, rel=1e-9)


def test_a_negative_advantage_counts_on_tasks_that_were_mastered_once() -> None:
    teacher = started("robust_plr", score="mna", replay_share=1.0, fill_first=1.0, buffer_size=2)
    for mastered in (False, True):
        play(teacher, teacher.propose(), 3.0, value=5.0, mastered=mastered)
    three_ones = trajectory([1.0, 1.0, 1.0], True, gamma=1.0)
    expected = negative_advantage(three_ones, np.full(4, 5.0), 0.9)
    assert teacher.buffer_.scores.tolist() == [0.0, pytest.approx(expected)]
    for _ in range(20):  # failing later takes nothing from it
        play(teacher, teacher.propose(), 3.0, value=5.0)
    assert teacher.buffer_.mastered.tolist() == [False, True]
    assert teacher.buffer_.scores[1] > 0


@pytest.mark.parametrize("score", ["positive_value_loss", "max_mc"])
def test_values_with_an_entropy_bonus_are_compared_with_rewards_that_have_it(score: str) -> None:
    """A student that knows its soft values has no regret; one that does not has the same with and without."""
    rewards, bonuses = np.array([1.0, 2.0, 4.0]), np.array([0.5, -0.25, 0.125])
    scores = []
    for bonus in (np.zeros(3), bonuses):
        teacher = started("plr", score=score, gae_lambda=1.0)
        following, values = 0.0, np.full(4, 99.0)
        for step in (2, 1, 0):
            following = values[step] = rewards[step] + bonus[step] + 0.9 * following
        gained = float(np.polynomial.polynomial.polyval(0.9, rewards))
        teacher.observe(replace(ended(teacher.propose().task, 7.0), discounted_return=gained, trains=True))
        asked = teacher.answer(replace(trajectory(list(rewards), True), entropy_bonuses=bonus))
        teacher.answer(values[: len(asked.observations)] - 2.0)
        scores += list(teacher.buffer_.scores)
    assert scores == pytest.approx([2.0, 2.0])


def buffer_of(scores: list[float], capacity: int = 3, staleness_share: float = 0.25) -> TaskBuffer:
    buffer = TaskBuffer(1, capacity, 0.5, staleness_share)
    for place, score in enumerate(scores):
        buffer.offer(np.array([place], np.float32), score, score)
    return buffer


def test_a_buffer_of_an_older_checkpoint_is_restored_and_goes_on() -> None:
    older = {name: value for name, value in vars(buffer_of([5.0, 9.0])).items() if name != "mastered"}
    buffer = TaskBuffer.__new__(TaskBuffer)
    buffer.__setstate__(older)
    assert buffer.offer(np.array([2], np.float32), 7.0, 7.0, mastered=True) == 2
    assert buffer.mastered.tolist() == [False, False, True]


def test_chances_are_those_of_ranks_and_staleness() -> None:
    buffer = buffer_of([5.0, 9.0, 1.0])
    by_score = np.array([1 / 4, 1, 1 / 9]) / (1 / 4 + 1 + 1 / 9)
    np.testing.assert_allclose(buffer.chances(), 0.75 * by_score + 0.25 / 3)
    buffer.replay(1)
    buffer.replay(2)
    np.testing.assert_allclose(buffer.chances(), 0.75 * by_score + 0.25 * np.array([2, 1, 0]) / 3)
    drawn = np.bincount(buffer.draw(np.random.default_rng(0), 20_000), minlength=3) / 20_000
    np.testing.assert_allclose(drawn, buffer.chances(), atol=0.01)


def test_a_new_task_replaces_the_one_replayed_least_if_it_scores_as_high() -> None:
    buffer = buffer_of([5.0, 9.0, 1.0], staleness_share=0.0)
    buffer.offer(np.array([3], np.float32), 0.5, 0.5)
    assert sorted(buffer.scores) == [1.0, 5.0, 9.0]
    buffer.offer(np.array([4], np.float32), 1.0, 7.0)
    assert buffer.tasks[:, 0].tolist() == [0, 1, 4]
    assert buffer.best.tolist() == [5.0, 9.0, 7.0]


def started(name: str, level: KnowledgeLevel = KnowledgeLevel.NONE, **settings: object) -> PrioritisedReplay:
    settings = {"buffer_size": 20, "staleness_share": 0.3, **settings}
    return simulated_play.started(name, SPACE, level=level, easy_task=[0.2, 7, 5.8], **settings)


def play(
    teacher: PrioritisedReplay, proposal: Proposal, gained: float, value: float = 0.0, mastered: bool = False
) -> None:
    """Play an episode of three steps, each of which returns a third."""
    episode = ended(proposal.task, gained, mastered)
    query = teacher.observe(replace(episode, discounted_return=gained, trains=proposal.trains))
    while query is not None:
        if query.kind is QueryKind.TRAJECTORY:
            query = teacher.answer(trajectory([gained / 3] * 3, True, gamma=1.0))
        else:
            query = teacher.answer(np.full(len(query.observations), value))


@pytest.mark.parametrize(("name", "trains"), [("plr", True), ("robust_plr", False), ("accel", False)])
def test_new_tasks_fill_the_buffer_before_it_is_replayed(name: str, trains: bool) -> None:
    teacher = started(name)
    proposals = []
    for index in range(400):
        proposals.append(teacher.propose())
        play(teacher, proposals[-1], float(index % 7))
    assert all(one.trains == trains for one in proposals[:10])
    assert len(teacher.buffer_) == 20
    share = sum(one.trains for one in proposals[10:]) / 390
    expected = {"plr": 1.0, "robust_plr": 0.5, "accel": 0.9 / 1.9}[name]  # an edit follows each replay
    assert share == pytest.approx(expected, abs=0.08)


@pytest.mark.parametrize(("budget", "capacity"), [(20_000_000, 1000), (2_000_000, 316), (200_000, 100)])
def test_the_buffer_is_scaled_by_the_square_root_of_the_budget(budget: int, capacity: int) -> None:
    teacher = started("plr", buffer_size=1000, budget=budget)
    waited = 0
    while teacher.replayed_ is None:
        play(teacher, teacher.propose(), 1.0)
        waited += teacher.replayed_ is None
    assert waited == pytest.approx(capacity / 2, abs=12)  # from half of it on, by chance


def test_high_scores_are_replayed_most() -> None:
    teacher = started("robust_plr", score="max_mc", replay_share=1.0, fill_first=1.0)
    for index in range(20):
        play(teacher, teacher.propose(), 100.0 + index, value=40.0)
    np.testing.assert_allclose(sorted(teacher.buffer_.scores), np.arange(60.0, 80.0))
    best = teacher.buffer_.tasks[teacher.buffer_.scores.argmax()].copy()
    times = 0
    for _ in range(200):
        proposal = teacher.propose()
        assert proposal.trains
        times += bool((proposal.task == best).all())
        play(teacher, proposal, 0.0, value=40.0)  # worse than the best return seen, which counts
    np.testing.assert_allclose(sorted(teacher.buffer_.scores), np.arange(60.0, 80.0))
    assert times / 200 == pytest.approx(0.7 + 0.3 / 20, abs=0.08)


def test_an_edit_moves_coordinates_of_the_task_just_replayed() -> None:
    teacher = started("accel", replay_share=1.0, fill_first=1.0)
    step = 0.04 * np.array([3, 0, 6])
    before, edits = None, 0
    for index in range(300):
        proposal = teacher.propose()
        if before is not None and not proposal.trains and before.trains:
            moved = proposal.task.astype(float) - before.task
            inside = (proposal.task > SPACE.low) & (proposal.task < SPACE.high)
            whole = np.divide(moved, step, out=np.zeros(3), where=step > 0)[inside]
            np.testing.assert_allclose(whole, np.round(whole), atol=1e-4)
            assert np.abs(whole).sum() <= 3 + 1e-4
            edits += 1
        assert not (before is not None and before.trains and proposal.trains), "each replay is edited"
        before = proposal
        play(teacher, proposal, float(index % 5))
    assert edits > 100


def test_accel_starts_from_easy_tasks_where_an_expert_knows_them() -> None:
    teacher = started("accel", KnowledgeLevel.HIGH)
    proposed = np.stack([teacher.propose().task for _ in range(500)])
    for tasks in (proposed, teacher.probe(500)):
        np.testing.assert_allclose(tasks.mean(axis=0), [0.27, 7, 5.6], atol=0.2)


def test_a_budget_is_absent_where_it_is_the_papers() -> None:
    assert "budget" not in hyperparameters_of(make_teacher("accel:budget=20000000"))
    assert hyperparameters_of(make_teacher("accel:budget=100"))["budget"] == 100
    assert canonical_teacher("accel:budget=2e6") == "accel:budget=2000000"
