"""ACCEL: robust PLR with edits of replayed tasks (Parker-Holder et al. 2022)."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tma_ray.support.validation import check_at_least, check_positive, check_shares
from tma_ray.tasks import ExpertKnowledge, KnowledgeLevel, Proposal, Task, TaskSpace
from tma_ray.teachers.prioritised_replay import PrioritisedReplay


@dataclass
class ACCEL(PrioritisedReplay):
    """Robust PLR that also plays edited copies of the tasks just replayed.

    An edit moves random coordinates up, down or not at all; the edited task is played for its score. Other
    new tasks are uniform or, at high expert knowledge, from the initial Gaussian, since the method prefers to
    start from easy tasks.

    Sources: Parker-Holder et al. 2022, algorithm 1, and the authors' code of BipedalWalker.

    Attributes:
        replay_share: highest probability of a replay instead of a new task, in [0, 1], which is bounded by
            the filled share of the buffer (paper: p).
        edit_share: probability of an edit after a replay, in [0, 1] (paper: q).
        edits: coordinates of one edit, with repetitions (paper: number of edits).
        edit_step: largest step of an edit, as a share of the dimension's range.
    """

    withholds_episodes: ClassVar[bool] = True
    algorithm_version: ClassVar[int | None] = 1
    knowledge_levels: ClassVar[tuple[KnowledgeLevel, ...]] = (KnowledgeLevel.NONE, KnowledgeLevel.HIGH)
    wants_evaluations: ClassVar[bool] = True
    new_tasks_train: ClassVar[bool] = False

    replay_share: float = 0.9
    edit_share: float = 1.0
    edits: int = 3
    edit_step: float = 0.04

    def __post_init__(self) -> None:
        super().__post_init__()
        check_shares(self, "edit_share", "edit_step")
        check_at_least(self, 1, "edits")
        check_positive(self, "edit_step")

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        """Start with an empty buffer."""
        super().start(space, knowledge, rng)
        self.edited_: Task | None = None

    def sample(self) -> Task | Proposal:
        """Return the edited copy of the task just replayed, if any, otherwise a task as in robust PLR."""
        if self.edited_ is None:
            return super().sample()
        task, self.edited_, self.replayed_ = self.edited_, None, None
        return Proposal(task, trains=False)

    def new_tasks(self, rng: np.random.Generator, count: int | None = None) -> Task:
        """Return a new task (d,), or `count` new tasks (count, d).

        They are drawn from the initial Gaussian at high expert knowledge, otherwise uniformly.
        """
        if self.knowledge.level is KnowledgeLevel.HIGH:
            return self.knowledge.initial.sample(self.space, rng, count)
        return super().new_tasks(rng, count)

    def after_replay(self, task: Task) -> None:
        """Edit a copy of `task` (d,) for the next episode, with probability `edit_share`."""
        if self.rng.random() < self.edit_share:
            free = np.flatnonzero(self.space.width > 0)
            moved = task.astype(np.float64)
            if len(free):
                dimensions = self.rng.choice(free, self.edits)
                directions = self.rng.integers(-1, 2, self.edits)
                np.add.at(moved, dimensions, directions * self.edit_step * self.space.width[dimensions])
            self.edited_ = self.space.clip(moved)
