"""The buffer of tasks that are replayed by rank of their score and by staleness."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tma_ray.tasks import Task

Array = NDArray[np.float64]


@dataclass
class TaskBuffer:
    """At most `capacity` tasks with what decides how often they are replayed.

    Task i is replayed with the chance (1 - rho) P_S(i) + rho P_C(i), where P_S is proportional to
    (1 / rank of its score) ** (1 / temperature), and P_C to the replays since it was played (Jiang et al.
    2021a, section 3). A new task takes the place of the one that is replayed least, if it scores as high.

    Attributes:
        size: number d of dimensions of a task.
        capacity: most tasks.
        temperature: beta.
        staleness_share: rho, in [0, 1].
        tasks: float32 (k, d).
        scores: (k,).
        staleness: replays since the task was played (k,).
        best: highest discounted return that was seen on the task (k,).
    """

    size: int
    capacity: int
    temperature: float
    staleness_share: float
    tasks: Task = field(init=False)
    scores: Array = field(init=False)
    staleness: Array = field(init=False)
    best: Array = field(init=False)

    def __post_init__(self) -> None:
        self.tasks = np.empty((0, self.size), dtype=np.float32)
        self.scores, self.staleness, self.best = np.empty(0), np.empty(0), np.empty(0)

    def __len__(self) -> int:
        return len(self.tasks)

    @property
    def filled(self) -> float:
        """Share of the capacity that is taken."""
        return len(self) / self.capacity

    def chances(self) -> Array:
        """Returns the chance of each task (k,) to be replayed next."""
        ranks = np.empty(len(self))
        ranks[np.argsort(-self.scores, kind="stable")] = np.arange(1, len(self) + 1)
        by_score = ranks ** (-1 / self.temperature)
        stale = self.staleness if self.staleness.any() else np.ones(len(self))
        shares = np.array([1 - self.staleness_share, self.staleness_share])
        chances: Array = shares @ np.stack([by_score / by_score.sum(), stale / stale.sum()])
        return chances

    def draw(self, rng: np.random.Generator, count: int) -> NDArray[np.int64]:
        """Returns the places (count,) of tasks to replay; none of them grows staler by it."""
        cumulative = np.cumsum(self.chances())
        places: NDArray[np.int64] = np.searchsorted(
            cumulative, rng.random(count) * cumulative[-1], side="right"
        )
        return places

    def replay(self, place: int) -> Task:
        """Returns the task (d,) at `place`, and makes all others staler."""
        self.staleness += 1
        self.staleness[place] = 0
        task: Task = self.tasks[place].copy()
        return task

    def rescore(self, place: int, score: float, best: float) -> None:
        """Takes over what an episode of the task at `place` gave."""
        self.scores[place], self.best[place] = score, best

    def offer(self, task: Task, score: float, best: float) -> None:
        """Takes `task` (d,) in, unless the buffer is full and the task that would give way scores higher."""
        if len(self) < self.capacity:
            self.tasks = np.vstack([self.tasks, task])
            added = (self.scores, score), (self.staleness, 0.0), (self.best, best)
            self.scores, self.staleness, self.best = (np.append(column, value) for column, value in added)
            return
        place = int(self.chances().argmin())
        if self.scores[place] <= score:
            self.tasks[place], self.staleness[place] = task, 0.0
            self.rescore(place, score, best)
