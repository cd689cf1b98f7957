"""ProCuRL-Target, a proximal curriculum with task correlations (Tzannetos et al. 2024)."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tma_ray.support.validation import check_at_least, check_positive
from tma_ray.tasks import Episode, ExpertKnowledge, Task, TaskSpace, TeacherUpdate
from tma_ray.teachers.base import PAPER_BUDGET, DistributionTeacher, for_budget, next_due
from tma_ray.teachers.currot import Performance
from tma_ray.teachers.numerics import (
    HIGHEST_RETURN,
    LOWEST_RETURN,
    Array,
    UnitBox,
    cloud_gaussian,
    draw_in_proportion,
    scaled_returns,
    softmax,
)

MOST_EPISODES = 2_000  # largest number of episodes in an estimate of values, to bound computation time


def similarity(points: Array, targets: Array, reach: float) -> Array:
    """Return similarities exp(-distance / reach) (m, n) between `targets` (m, f) and `points` (n, f)."""
    from scipy.spatial.distance import cdist  # deferred, so that listing teachers does not import scipy

    return np.asarray(np.exp(-cdist(targets, points) / reach), dtype=np.float64)


def proximity(values: Array, target_values: Array, similarities: Array) -> Array:
    """Return the scores (n,) of tasks, high at medium difficulty and near targets of medium difficulty.

    The score of a task c is the maximum of V(c) (1 - V(c)) V(t) (1 - V(t)) k(c, t) over targets t.

    Args:
        values: values V of the tasks (n,), in [0, 1].
        target_values: values V of the targets (m,).
        similarities: similarities k of each target and task (m, n).
    """
    of_targets = ((target_values * (1 - target_values))[:, None] * similarities).max(axis=0)
    return np.asarray(values * (1 - values) * of_targets, dtype=np.float64)


@dataclass
class ProCuRLTarget(DistributionTeacher):
    """Teacher that samples a pool of tasks by a softmax of scores, high at medium difficulty near targets.

    The score of a task is its `proximity`. Values are expected returns, scaled to [0, 1] and estimated by
    kernel averages of the returns since the last update. Before the first update tasks are uniform.

    Sources: Tzannetos et al. 2024 (arXiv:2405.02481) for the score, read in a summary; the authors' code for
    this benchmark (``teachers_tma/proxcorl.py``) for pool, targets, kernel, softmax and intervals.

    Attributes:
        beta: weight of the scores in the softmax (authors' code: 110 by default).
        pool_size: number of tasks in the pool.
        target_samples: draws of the target distribution, which is uniform (authors' code).
        reach: distance in the unit box at which the similarity of tasks is 1 / e (authors' code: 1 in task
            units, which is a third and a sixth of the ranges of Stump Tracks).
        kernel_width: standard deviation of the kernel of the values, as a share of the unit box's diagonal.
        lowest_return: return of value 0 (original release).
        highest_return: return of value 1 (original release).
        first_update: environment steps before the first update.
        update_every: environment steps between two updates; every second one draws a new pool.
        budget: environment steps of the run, to which `for_budget` fits first_update and update_every.
    """

    overlapping: ClassVar[bool] = True
    algorithm_version: ClassVar[int | None] = 1
    single_task: ClassVar[bool] = False

    beta: float = 110.0
    pool_size: int = 1000
    target_samples: int = 250
    reach: float = 0.25
    kernel_width: float = 0.1
    lowest_return: float = LOWEST_RETURN
    highest_return: float = HIGHEST_RETURN
    first_update: int = 500_000
    update_every: int = 1_000_000
    budget: int = PAPER_BUDGET

    def __post_init__(self) -> None:
        check_positive(self, "beta", "reach", "kernel_width")
        check_at_least(self, 1, "pool_size", "target_samples", "first_update", "update_every")
        scaled_returns(np.empty(0), self.lowest_return, self.highest_return)
        for_budget(self.update_every, self.budget)

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        """Start with a pool of equally likely tasks."""
        super().start(space, knowledge, rng)
        self._box = UnitBox(space)
        self.tasks_: list[Task] = []
        self.returns_: list[float] = []
        self.updates_ = 0
        self.next_update_ = for_budget(self.first_update, self.budget)
        self.pool_ = rng.random((self.pool_size, self._box.size))
        self.chances_ = np.full(self.pool_size, 1 / self.pool_size)

    def draw(self, rng: np.random.Generator, count: int) -> Task:
        """Return `count` tasks (count, d) from the pool."""
        indices = [draw_in_proportion(self.chances_, rng) for _ in range(count)]
        return self._box.denormalise(self.pool_[indices])

    def observe(self, episode: Episode) -> None:
        """Store the episode, and score the pool when an update is due."""
        self.tasks_.append(episode.task)
        self.returns_.append(episode.episodic_return)
        if episode.step < self.next_update_:
            return
        every = for_budget(self.update_every, self.budget)
        self.next_update_ = next_due(self.next_update_, every, episode.step)
        self._update()

    def _update(self) -> None:
        self.updates_ += 1
        if self.updates_ % 2 == 0:
            self.pool_ = self.rng.random(self.pool_.shape)
        targets = self.rng.random((self.target_samples, self._box.size))
        played = self._box.normalise(np.stack(self.tasks_[-MOST_EPISODES:]))
        returns = np.array(self.returns_[-MOST_EPISODES:])
        performance = Performance(played, returns, self.kernel_width * np.sqrt(self._box.size))
        bounds = self.lowest_return, self.highest_return
        values, target_values = (
            scaled_returns(performance(points), *bounds) for points in (self.pool_, targets)
        )
        scores = proximity(values, target_values, similarity(self.pool_, targets, self.reach))
        self.chances_ = softmax(scores, 1 / self.beta)
        self.tasks_, self.returns_ = [], []
        scalars = {
            "mean_value": float(self.chances_ @ values),
            "target_value": float(target_values.mean()),
            "mean_return": float(returns.mean()),
            "tasks_in_use": float(1 / (self.chances_**2).sum()),
        }
        gaussian = cloud_gaussian(self.space, self._box.denormalise(self.pool_), self.chances_)
        self.log(TeacherUpdate(gaussians=(gaussian,), scalars=scalars))
