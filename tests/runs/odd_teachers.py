"""Teachers with unusual behaviour, outside the catalogue: ``odd_teachers:Name``."""

from __future__ import annotations

import functools
import operator
from dataclasses import dataclass, field

import numpy as np

from tma_ray.tasks import (
    Answer,
    Episode,
    KnowledgeLevel,
    Outcomes,
    Proposal,
    Query,
    QueryKind,
    Task,
    TeacherUpdate,
    Trajectory,
)
from tma_ray.teachers import Teacher
from tma_ray.teachers.random import Random


@dataclass
class Inquisitive(Random):
    """Teacher that queries the value of every initial observation, and requires the answer."""

    asked_: int = 0
    answers_: list[float] = field(default_factory=list)

    def observe(self, episode: Episode) -> Query:
        self.asked_ += 1
        return Query(QueryKind.STATE_VALUES, episode.initial_observation[None])

    def answer(self, values: np.ndarray) -> None:
        self.answers_.append(float(values.item()))

    def sample(self) -> Task:
        assert len(self.answers_) == self.asked_
        return super().sample()


@dataclass
class Scrutinising(Random):
    """Teacher that queries and checks all trajectories and the values along them."""

    wants_trajectory = True

    episode_: Episode | None = field(default=None, init=False)
    returns_: list[float] = field(default_factory=list, init=False)

    def observe(self, episode: Episode) -> Query:
        self.episode_ = episode
        return Query(QueryKind.TRAJECTORY)

    def answer(self, answer: Answer) -> Query | None:
        assert self.episode_ is not None
        length = self.episode_.length
        if isinstance(answer, Trajectory):
            assert answer.observations.shape == (length + 1, 3)
            assert answer.actions.shape == (length, 2)
            assert answer.rewards.shape == (length,)
            assert answer.observations.dtype == answer.actions.dtype == np.float32
            assert answer.terminated or length == 30, "the corridor is cut there"
            np.testing.assert_array_equal(answer.observations[0], self.episode_.initial_observation)
            np.testing.assert_allclose(answer.observations[:, 2], np.arange(length + 1) / 30, rtol=1e-6)
            # Since Python 3.12, sum compensates for rounding errors, unlike an environment.
            total = functools.reduce(operator.add, answer.rewards.tolist())
            assert total == self.episode_.episodic_return
            return Query(QueryKind.STATE_VALUES, answer.observations)
        assert answer.shape == (length + 1,)
        self.returns_.append(self.episode_.episodic_return)
        update = TeacherUpdate(scalars={"heard": float(len(self.returns_)), "last_value": float(answer[-1])})
        self.log(update)
        return None


@dataclass
class Examining(Random):
    """Teacher with every second episode untrained, and an evaluation query after every sixth."""

    wants_evaluations = True

    episodes_: int = field(default=0, init=False)

    def sample(self) -> Proposal:
        return Proposal(super().sample(), trains=self.episodes_ % 2 == 0)

    def observe(self, episode: Episode) -> Query | None:
        assert episode.trains == (self.episodes_ % 2 == 0)
        self.episodes_ += 1
        if self.episodes_ % 6:
            return None
        tasks = self.space.sample(self.rng, 5)
        return Query(QueryKind.EVALUATION, tasks=tasks, greedy=self.episodes_ % 12 == 0)

    def answer(self, outcomes: Outcomes) -> None:
        assert outcomes.episodic_returns.shape == outcomes.successes.shape == outcomes.lengths.shape == (5,)
        steps, mean = float(outcomes.lengths.sum()), float(outcomes.episodic_returns.mean())
        self.log(TeacherUpdate(scalars={"steps": steps, "mean_return": mean}))


@dataclass
class Watching(Random):
    """Teacher without any trained episode."""

    wants_evaluations = True

    def sample(self) -> Proposal:
        return Proposal(super().sample(), trains=False)


@dataclass
class Covert(Random):
    """Teacher with untrained episodes that it does not declare."""

    def sample(self) -> Proposal:
        return Proposal(super().sample(), trains=False)


@dataclass
class Prying(Random):
    """Teacher with evaluation queries that it does not declare."""

    def observe(self, episode: Episode) -> Query:
        return Query(QueryKind.EVALUATION, tasks=episode.task[None])


@dataclass
class Undeclared(Random):
    """Teacher with trajectory queries that it does not declare."""

    def observe(self, episode: Episode) -> Query:
        return Query(QueryKind.TRAJECTORY)


@dataclass
class Outsider(Random):
    """Teacher with tasks outside of its space."""

    def sample(self) -> Task:
        return super().sample() + np.float32(100)


@dataclass
class NeedsLow(Teacher):
    """Teacher that requires a mastery threshold."""

    knowledge_levels = (KnowledgeLevel.LOW,)

    def sample(self) -> Task:
        return self.space.low
