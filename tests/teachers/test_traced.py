"""TRACED: the transition error, the difficulty of a hand-made episode, and co-learnability."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from simulated_play import ended
from test_replay import started

from tma_ray.tasks import QueryKind, Trajectory
from tma_ray.teachers.prioritised_replay import PrioritisedReplay, positive_value_loss
from tma_ray.teachers.traced import TRACED, TransitionModel


def moving(seed: int, steps: int = 50, drag: float = 0.2) -> Trajectory:
    """Return an episode whose first two observations follow linear dynamics; the third never changes."""
    rng = np.random.default_rng(seed)
    actions = rng.normal(size=(steps, 1)).astype(np.float32)
    observations = np.zeros((steps + 1, 3), np.float32)
    observations[:, 2] = 7.0
    for step in range(steps):
        x, v, _ = observations[step]
        observations[step + 1, :2] = x + 0.1 * v, (1 - drag) * v + actions[step, 0]
    return Trajectory(observations, actions, rng.normal(size=steps), True, 0.9)


def test_a_model_learns_the_transitions_and_is_surprised_by_others() -> None:
    model = TransitionModel(memory=0.9)
    errors = [model.error(moving(seed)) for seed in range(20)]
    assert errors[0] == pytest.approx(2 / 3)  # two of three parts change, and none was predicted
    assert errors[-1] < 0.01 * errors[0]
    assert model.error(moving(21, drag=0.9)) > 10 * errors[-1]


def test_the_error_is_that_of_a_ridge_regression_on_what_came_before() -> None:
    model = TransitionModel(memory=0.5)
    episodes = [moving(seed, steps=20) for seed in range(3)]
    errors = [model.error(one) for one in episodes]
    inputs = [np.hstack([np.ones((20, 1)), one.observations[:-1], one.actions]) for one in episodes]
    changes = [np.diff(one.observations.astype(float), axis=0) for one in episodes]
    counts = np.repeat([0.5, 1.0], 20)[:, None]
    before, wanted = np.vstack(inputs[:2]), np.vstack(changes[:2])
    weights = np.linalg.solve(before.T @ (counts * before) + np.eye(5), before.T @ (counts * wanted))
    squares = (changes[2] - inputs[2] @ weights) ** 2
    power = sum(share * (one**2).sum(axis=0) for share, one in zip((0.25, 0.5, 1.0), changes, strict=True))
    scale = power / (20 * 1.75)
    assert errors[2] == pytest.approx((squares[:, :2].mean(axis=0) / scale[:2]).sum() / 3)


def test_difficulty_is_the_positive_value_loss_and_the_weighted_error() -> None:
    teacher = started("traced", error_weight=3.0, gae_lambda=0.8)
    values, expected, model = np.linspace(1, 2, 51), [], TransitionModel(memory=0.99)
    for seed in range(3):
        teacher.observe(ended(teacher.propose().task))
        episode = moving(seed)
        assert teacher.answer(episode).kind is QueryKind.STATE_VALUES
        teacher.answer(values)
        expected.append(positive_value_loss(episode, values, 0.8) + 3.0 * model.error(episode))
    np.testing.assert_allclose(teacher.buffer_.scores, expected)


def test_co_learnability_is_the_drop_of_difficulty_a_round_later(monkeypatch: pytest.MonkeyPatch) -> None:
    """The recurrence, by hand, over rounds of two replays."""
    drawn = iter(np.random.default_rng(3).uniform(1, 9, 100))
    measured: list[float] = []

    def estimate(_self: PrioritisedReplay, *_: Any) -> float:
        measured.append(float(next(drawn)))
        return measured[-1]

    monkeypatch.setattr(TRACED, "estimate", estimate)
    settings = {"buffer_size": 3, "replay_share": 1.0, "fill_first": 1.0, "edit_share": 0.0}
    teacher = started("traced", round_size=2, co_learnability_weight=0.5, **settings)
    difficulties: dict[int, float] = {}
    gains = dict.fromkeys(range(3), 0.0)
    rounds: list[list[int]] = [[]]
    drops: list[list[float]] = [[]]
    for _ in range(23):
        proposal = teacher.propose()
        place = teacher.replayed_
        replayed = place is not None
        place = len(difficulties) if place is None else place
        one = Trajectory(np.zeros((2, 1), np.float32), np.zeros((1, 1), np.float32), np.zeros(1), True, 0.9)
        teacher.observe(ended(proposal.task))
        teacher.answer(one)
        teacher.answer(np.zeros(2))
        if replayed:
            rounds[-1].append(place)
            drops[-1].append(difficulties[place] - measured[-1])
        difficulties[place] = measured[-1]
        if len(rounds[-1]) == 2:
            for earlier in rounds[-2] if len(rounds) > 1 else []:
                gains[earlier] = sum(drops[-1]) / 2
            rounds.append([])
            drops.append([])
        expected = [difficulties[task] + 0.5 * gains[task] for task in sorted(difficulties)]
        np.testing.assert_allclose(teacher.buffer_.scores, expected)
    assert len(rounds) == 11
    ranks = np.argsort(np.argsort(-teacher.buffer_.scores)) + 1
    stale: NDArray[np.float64] = teacher.buffer_.staleness / teacher.buffer_.staleness.sum()
    np.testing.assert_allclose(teacher.buffer_.chances(), 0.7 * (1 / ranks) / (1 / ranks).sum() + 0.3 * stale)


def test_a_new_task_does_not_inherit_what_its_predecessor_did_for_others() -> None:
    teacher = started("traced", buffer_size=2)
    teacher.co_learnability_[:], teacher.previous_round_, teacher.round_ = 4.0, [0, 1], [1]
    teacher._forget(1)
    assert teacher.co_learnability_.tolist() == [4.0, 0.0]
    assert (teacher.previous_round_, teacher.round_) == ([0], [])
