"""Teachers with a query after every episode."""

from dataclasses import dataclass

import numpy as np

from tma_ray.tasks import Episode, ExpertKnowledge, Query, QueryKind, Task, TaskSpace, Trajectory
from tma_ray.teachers import Teacher


@dataclass
class AsksForValues(Teacher):
    """Samples near the task with the highest state value so far."""

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


@dataclass
class AsksForTrajectories(AsksForValues):
    """Samples near the task with the highest mean state value along its trajectory."""

    wants_trajectory = True

    def observe(self, episode: Episode) -> Query:
        super().observe(episode)
        self.length_ = episode.length
        return Query(QueryKind.TRAJECTORY)

    def answer(self, answer: np.ndarray | Trajectory) -> Query | None:
        if isinstance(answer, Trajectory):
            assert len(answer.observations) == len(answer.actions) + 1 == len(answer.rewards) + 1
            assert len(answer.rewards) == self.length_
            return Query(QueryKind.STATE_VALUES, answer.observations)
        return super().answer(answer.mean(keepdims=True))
