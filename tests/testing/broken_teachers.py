"""Teachers that break one requirement each, named after it."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import numpy as np

from tma_ray.tasks import Episode, KnowledgeLevel, ScoredBox, Task, TeacherUpdate, WeightedGaussian
from tma_ray.teachers.random import Random

COUNTER = itertools.count()


@dataclass
class LeavesItsSpace(Random):
    def sample(self) -> Task:
        return (super().sample() + 1e-3 * self.space.width).astype(np.float32)


@dataclass
class GivesFloat64(Random):
    def sample(self) -> Task:
        return super().sample().astype(np.float64)


@dataclass
class ProbesOutside(Random):
    def probe(self, count: int) -> Task:
        return super().probe(count) + np.float32(1)


@dataclass
class UsesGlobalRandomness(Random):
    def sample(self) -> Task:
        np.random.random()  # noqa: NPY002 - the kit has to find it
        return super().sample()


@dataclass
class IsNotSeeded(Random):
    """Teacher whose tasks vary between processes, as by iteration over a set."""

    def sample(self) -> Task:
        return self.space.denormalise(np.full(self.space.size, (0.37 * next(COUNTER)) % 1))


@dataclass
class IgnoresItsSeed(Random):
    def sample(self) -> Task:
        self.rng.random()
        return self.space.clip(self.space.centre)


@dataclass
class LearnsFromProbes(Random):
    """Teacher whose probes are repeatable but advance its generator."""

    def probe(self, count: int) -> Task:
        tasks = super().probe(count)
        self.rng.random()
        return self.space.clip(np.broadcast_to(self.space.centre, tasks.shape))


@dataclass
class ForgetsWhenSaved(Random):
    def sample(self) -> Task:
        task = super().sample()
        return self.space.clip(0.5 * (task + self.previous)) if hasattr(self, "previous") else task

    def observe(self, episode: Episode) -> None:
        self.previous = episode.task  # not saved, since its name does not end with an underscore


@dataclass
class Logs(Random):
    """Base class of teachers with invalid logs, which are returned by `update`."""

    def observe(self, episode: Episode) -> None:
        self.log(self.update())


@dataclass
class LogsSingularCovariances(Logs):
    def update(self) -> TeacherUpdate:
        size = self.space.size
        return TeacherUpdate(gaussians=(WeightedGaussian(1.0, np.zeros(size), np.zeros((size, size))),))


@dataclass
class LogsBoxesUpsideDown(Logs):
    def update(self) -> TeacherUpdate:
        box = ScoredBox(self.space.low.astype(float) + 1, self.space.low.astype(float), 0.0)
        return TeacherUpdate(boxes=(box,))


@dataclass
class LogsInfinity(Logs):
    def update(self) -> TeacherUpdate:
        return TeacherUpdate(scalars={"ratio": float("inf")})


@dataclass
class ListsIdleLevels(Random):
    knowledge_levels = (KnowledgeLevel.NONE, KnowledgeLevel.HIGH)


@dataclass
class ListsFallingLevels(Random):
    knowledge_levels = (KnowledgeLevel.HIGH, KnowledgeLevel.LOW)


@dataclass
class ChangesHyperparameters(Random):
    tries: int = 0

    def sample(self) -> Task:
        self.tries += 1
        return super().sample()


@dataclass
class NeedsHyperparameters(Random):
    target: float = field(kw_only=True)


class IsNoDataclass(Random):
    target: float = 1.0


class TakesAnything(Random):
    def __init__(self, **anything: object) -> None:
        super().__init__()


@dataclass
class NeedsSuccess(Random):
    """Teacher that aims at the mean of mastered tasks, which is NaN without any."""

    def start(self, *arguments: object) -> None:
        super().start(*arguments)
        self.mastered_: list[Task] = []
        self.episodes_ = 0

    def observe(self, episode: Episode) -> None:
        self.episodes_ += 1
        if episode.success:
            self.mastered_.append(episode.task)

    def sample(self) -> Task:
        if self.episodes_ < 50:
            return super().sample()
        spread = 0.1 * self.space.width * self.rng.random()
        mean = np.sum(self.mastered_, axis=0) / np.float64(len(self.mastered_) or np.nan)
        return self.space.clip(mean + spread)


@dataclass
class NeverStartsItsBase(Random):
    def start(self, space, knowledge, rng) -> None:
        self.history_ = []


@dataclass
class UsesItsSpaceTooEarly(Random):
    def start(self, space, knowledge, rng) -> None:
        self.middle_ = self.space.centre
        super().start(space, knowledge, rng)
