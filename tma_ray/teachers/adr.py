"""Automatic domain randomization (OpenAI 2019)."""

from dataclasses import dataclass
from statistics import fmean
from typing import ClassVar, NamedTuple

import numpy as np

from tma_ray.support.validation import check_at_least, check_positive, check_shares
from tma_ray.tasks import Episode, ExpertKnowledge, KnowledgeLevel, ScoredBox, Task, TaskSpace, TeacherUpdate
from tma_ray.teachers.base import Teacher
from tma_ray.teachers.numerics import draw_in_box


class Boundary(NamedTuple):
    """Boundary of the box, at side 0 (lower) or 1 (upper) of a dimension."""

    side: int
    dimension: int


@dataclass
class ADR(Teacher):
    """Teacher that samples uniformly from a box that grows where returns on its boundary are high.

    The box begins as a single task. With probability `boundary_share` one coordinate of a task is set to a
    random boundary of the box, and the return is queued for that boundary. The mean of a full queue moves the
    boundary out at `expand_at` or more, in at `shrink_at` or less, but not beyond the task space or the
    opposite boundary.

    Sources: OpenAI 2019 (Solving Rubik's Cube with a Robot Hand), algorithm 1; paper, appendix A and
    table of hyper-parameters. The paper's text grows the box at `shrink_at` and once inverts the test for
    queueing, by mistake. The original release queues the return of every task on a boundary.

    Attributes:
        shrink_at: highest mean return that moves a boundary in (paper: t_L).
        expand_at: lowest mean return that moves a boundary out (paper: t_H).
        queue_size: returns in a full queue (paper: m).
        boundary_share: share of tasks set to a boundary, in [0, 1] (paper: p_b).
        step: step of a boundary, in units of its dimension (paper: Delta).
    """

    overlapping: ClassVar[bool] = True
    episode_state: ClassVar[tuple[str, ...]] = ("boundary_",)
    algorithm_version: ClassVar[int | None] = 1
    knowledge_levels: ClassVar[tuple[KnowledgeLevel, ...]] = (KnowledgeLevel.LOW, KnowledgeLevel.HIGH)

    shrink_at: float = 0.0
    expand_at: float = 180.0
    queue_size: int = 10
    boundary_share: float = 0.7
    step: float = 0.1

    def __post_init__(self) -> None:
        if not self.shrink_at < self.expand_at:
            raise ValueError(f"shrink_at = {self.shrink_at}: expected less than expand_at = {self.expand_at}")
        check_at_least(self, 1, "queue_size")
        check_shares(self, "boundary_share")
        check_positive(self, "step")

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        """Start with the initial Gaussian's mean as the only task."""
        super().start(space, knowledge, rng)
        example = space.clip(knowledge.initial.mean).astype(np.float64)
        self.bounds_ = np.stack([example, example])
        self.queues_: dict[Boundary, list[float]] = {}
        self.boundary_: Boundary | None = None
        self._log_box(0.0)

    def sample(self) -> Task:
        """Return a task (d,) from the box or from one of its boundaries."""
        task = draw_in_box(self.space, self.bounds_, self.rng)
        self.boundary_ = None
        dimensions = np.flatnonzero(self.space.width > 0)
        if self.rng.random() < self.boundary_share and len(dimensions):
            dimension = int(self.rng.choice(dimensions))
            lower, upper = self.bounds_[:, dimension].astype(np.float32)
            # a dimension that already spans the task space has no boundary to move
            if lower != self.space.low[dimension] or upper != self.space.high[dimension]:
                self.boundary_ = Boundary(int(self.rng.integers(2)), dimension)
        if self.boundary_ is not None:
            task[self.boundary_.dimension] = self.bounds_[self.boundary_]
        return task

    def observe(self, episode: Episode) -> None:
        """Queue the return if the task was on a boundary, and move the boundary when its queue is full."""
        if self.boundary_ is None:
            return
        queue = self.queues_.setdefault(self.boundary_, [])
        queue.append(episode.episodic_return)
        if len(queue) == self.queue_size:
            del self.queues_[self.boundary_]
            self._move(self.boundary_, fmean(queue))
        self.boundary_ = None

    def probe(self, count: int) -> Task:
        """Return `count` uniform tasks (count, d) from the box."""
        rng = self.probe_rng()
        return np.stack([draw_in_box(self.space, self.bounds_, rng) for _ in range(count)])

    def _move(self, boundary: Boundary, mean_return: float) -> None:
        if self.shrink_at < mean_return < self.expand_at:
            return
        side, dimension = boundary
        outwards = mean_return >= self.expand_at
        upwards = outwards == (side == 1)
        edges = [self.bounds_[0, dimension], self.bounds_[1, dimension]]
        edges[side] = (self.space.low, self.space.high)[side][dimension]
        before = self.bounds_[boundary]
        self.bounds_[boundary] = np.clip(before + (self.step if upwards else -self.step), *edges)
        if self.bounds_[boundary] != before:
            self._log_box(mean_return)

    def _log_box(self, mean_return: float) -> None:
        """Log the box; its score is the mean return that moved a boundary."""
        low, high = self.bounds_.copy()
        width = self.space.width
        shares = (high - low)[width > 0] / width[width > 0]
        names = np.array(self.space.names)[width > 0]
        scalars = {f"share_of_{name}": float(share) for name, share in zip(names, shares, strict=True)}
        self.log(TeacherUpdate(boxes=(ScoredBox(low, high, mean_return),), scalars=scalars))
