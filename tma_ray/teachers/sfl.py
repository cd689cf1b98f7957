"""SFL, sampling for learnability (Rutherford et al. 2024)."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tma_ray.support.validation import check_at_least, check_shares
from tma_ray.tasks import (
    Episode,
    ExpertKnowledge,
    KnowledgeLevel,
    Outcomes,
    Query,
    QueryKind,
    Task,
    TaskSpace,
    TeacherUpdate,
)
from tma_ray.teachers.base import PAPER_BUDGET, Teacher, for_budget
from tma_ray.teachers.numerics import cloud_gaussian


@dataclass
class SFL(Teacher):
    """Teacher that samples tasks of highest learnability, found by regular evaluations of random tasks.

    The learnability of a task that the student masters with frequency p is p (1 - p). After the first
    episode, and then every `refresh_every` episodes, the student plays `rollouts` episodes of each of
    `candidates` uniform tasks with its exploring policy, without learning. The buffer holds the `kept` tasks
    of highest positive learnability.

    Sources: Rutherford et al. 2024, algorithms 1 and 2, in the authors' configuration of single-agent JaxNav.
    The evaluations, of millions of steps there, are reduced to about a fourth of the episodes in a budget of
    20 million steps, towards which they count here.

    Attributes:
        candidates: tasks evaluated in a refresh (paper: N = 5000).
        rollouts: episodes of each candidate (paper: as many as in 1000 steps).
        kept: largest number of tasks in the buffer (paper: K = 100).
        refresh_every: episodes between two refreshes (paper: T = 50 updates of 256 environments).
        budget: environment steps of the run, to which `for_budget` fits candidates, kept and refresh_every.
        buffer_share: share of tasks from the buffer, in [0, 1]; the others are uniform (paper: rho).
    """

    overlapping: ClassVar[bool] = True
    algorithm_version: ClassVar[int | None] = 1
    knowledge_levels: ClassVar[tuple[KnowledgeLevel, ...]] = (KnowledgeLevel.LOW,)
    wants_evaluations: ClassVar[bool] = True
    absent_at_default: ClassVar[frozenset[str]] = frozenset(("budget",))

    candidates: int = 60
    rollouts: int = 3
    kept: int = 20
    refresh_every: int = 500
    buffer_share: float = 0.5
    budget: int = PAPER_BUDGET

    def __post_init__(self) -> None:
        check_at_least(self, 1, "candidates", "kept", "refresh_every")
        check_at_least(self, 2, "rollouts")  # with a single rollout, p (1 - p) is always 0
        check_shares(self, "buffer_share")
        for_budget(self.kept, self.budget)

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        """Start with an empty buffer."""
        super().start(space, knowledge, rng)
        self.buffer_ = np.empty((0, space.size), dtype=np.float32)
        self.asked_: Task | None = None
        self.episodes_ = 0

    def sample(self) -> Task:
        """Return a task (d,) from the buffer, or a uniform one."""
        if len(self.buffer_) and self.rng.random() < self.buffer_share:
            task: Task = self.buffer_[self.rng.integers(len(self.buffer_))].copy()
            return task
        return self.space.sample(self.rng)

    def observe(self, episode: Episode) -> Query | None:  # noqa: ARG002 - only evaluations count
        """Request an evaluation when a refresh is due."""
        self.episodes_ += 1
        if (self.episodes_ - 1) % for_budget(self.refresh_every, self.budget):
            return None
        self.asked_ = self.space.sample(self.rng, for_budget(self.candidates, self.budget))
        return Query(QueryKind.EVALUATION, tasks=np.repeat(self.asked_, self.rollouts, axis=0))

    def answer(self, answer: Outcomes) -> None:
        """Fill the buffer with the tasks of highest learnability, breaking ties at random."""
        assert self.asked_ is not None, "an answer follows a query"
        candidates, kept = len(self.asked_), for_budget(self.kept, self.budget)
        mastered = answer.successes.reshape(candidates, self.rollouts).mean(axis=1)
        learnability = mastered * (1 - mastered)
        order = self.rng.permutation(candidates)
        order = order[np.argsort(-learnability[order], kind="stable")][:kept]
        order = order[learnability[order] > 0]
        self.buffer_, self.asked_ = self.asked_[order], None
        scalars = {
            "buffer_size": float(len(order)),
            "mean_learnability": float(learnability.mean()),
            "mastered_share": float(mastered.mean()),
        }
        gaussians = (cloud_gaussian(self.space, self.buffer_),) if len(order) else ()
        self.log(TeacherUpdate(gaussians=gaussians, scalars=scalars))

    def probe(self, count: int) -> Task:
        """Return `count` tasks (count, d) from the buffer, or uniform ones while it is empty."""
        rng = self.probe_rng()
        if not len(self.buffer_):
            return self.space.sample(rng, count)
        tasks: Task = self.buffer_[rng.integers(len(self.buffer_), size=count)]
        return tasks
