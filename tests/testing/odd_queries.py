"""A teacher that asks after every episode, as plug-ins may."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tma_ray.tasks import Episode, ExpertKnowledge, Query, QueryKind, Task, TaskSpace
from tma_ray.teachers import Teacher


@dataclass
class AsksForValues(Teacher):
    """Moves towards tasks of high value."""

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        super().start(space, knowledge, rng)
        self.best_, self.value_, self.last_ = space.centre, -np.inf, space.centre

    def sample(self) -> Task:
        return self.space.clip(self.rng.normal(self.best_, 0.1 * self.space.width))

    def observe(self, episode: Episode) -> Query:
        self.last_ = episode.task
        return Query(QueryKind.STATE_VALUES, episode.initial_observation[None])

    def answer(self, values: np.ndarray) -> None:
        assert values.shape == (1,)
        if values[0] > self.value_:
            self.best_, self.value_ = self.last_, float(values[0])
