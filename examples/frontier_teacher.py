"""A teacher of one's own: it stays where the student's return is close to a target."""

from dataclasses import dataclass

import numpy as np

from tma_ray.tasks import Episode, ExpertKnowledge, Task, TaskSpace
from tma_ray.teachers import Teacher


@dataclass
class Frontier(Teacher):
    """Samples near the recent task whose return was closest to `target`: neither too easy nor too hard."""

    target: float = 100.0  # episodic return aimed at
    spread: float = 0.1  # standard deviation of a proposal, as a share of each dimension's range
    explore: float = 0.2  # share of uniform tasks, in [0, 1]

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        super().start(space, knowledge, rng)
        self.recent_: list[tuple[float, Task]] = []  # saved, as its name ends in an underscore

    def sample(self) -> Task:
        return self._propose(self.rng, self.explore)

    def observe(self, episode: Episode) -> None:
        self.recent_ = [*self.recent_[-49:], (abs(episode.episodic_return - self.target), episode.task)]

    def probe(self, count: int) -> Task:
        rng = self.probe_rng()  # a separate generator: probes do not affect training
        return np.stack([self._propose(rng, explore=0.0) for _ in range(count)])

    def _propose(self, rng: np.random.Generator, explore: float) -> Task:
        if not self.recent_ or rng.random() < explore:
            return self.space.sample(rng)
        _, nearest = min(self.recent_, key=lambda seen: seen[0])
        return self.space.clip(rng.normal(nearest, self.spread * self.space.width))
