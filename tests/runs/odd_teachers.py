"""Teachers that do something unusual; named as ``odd_teachers:Name``, so that no catalogue holds them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tma_ray.tasks import Episode, KnowledgeLevel, Query, QueryKind, Task
from tma_ray.teachers import Teacher
from tma_ray.teachers.random import Random


@dataclass
class Inquisitive(Random):
    """Asks V of the initial observation after every episode, and insists on the answer."""

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
class Outsider(Random):
    """Leaves its space."""

    def sample(self) -> Task:
        return super().sample() + np.float32(100)


@dataclass
class NeedsLow(Teacher):
    """Cannot do without a mastery threshold."""

    knowledge_levels = (KnowledgeLevel.LOW,)

    def sample(self) -> Task:
        return self.space.low
