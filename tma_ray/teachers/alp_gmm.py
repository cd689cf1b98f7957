"""ALP-GMM (Portelas et al. 2019)."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.spatial import KDTree

from tma_ray.tasks import Episode, ExpertKnowledge, Task, TaskSpace
from tma_ray.teachers.mixtures import Mixture, MixtureTeacher
from tma_ray.teachers.numerics import Array


class NearestReturn:
    """History of tasks and returns, with nearest-neighbour search.

    A kd-tree holds all but the latest rows, which are searched directly, and is rebuilt every `rebuild_every`
    rows. It depends on the rows alone, so that a loaded history gives the same results.
    """

    def __init__(self, size: int, rebuild_every: int = 500) -> None:
        self.rebuild_every = rebuild_every
        self._count = 0
        self._in_tree = 0
        self._tree: KDTree | None = None
        self._tasks = np.empty((rebuild_every, size))
        self._returns = np.empty(rebuild_every)

    def __len__(self) -> int:
        return self._count

    def add(self, task: Task, episodic_return: float) -> None:
        """Append a task (d,) and its return."""
        if self._count == len(self._returns):
            self._tasks = np.concatenate([self._tasks, np.empty_like(self._tasks)])
            self._returns = np.concatenate([self._returns, np.empty_like(self._returns)])
        self._tasks[self._count], self._returns[self._count] = task, episodic_return
        self._count += 1
        if self._count % self.rebuild_every == 0:
            self._build()

    def nearest(self, task: Task) -> float:
        """Return the episodic return of the stored task nearest to `task` (d,) in Euclidean distance."""
        assert self._count, "an empty history has no nearest task"
        recent = self._tasks[self._in_tree : self._count]
        distances = np.sum((recent - task) ** 2, axis=1)
        best, index = np.inf, -1
        if len(recent):
            index = self._count - 1 - int(np.argmin(distances[::-1]))
            best = float(distances[index - self._in_tree])
        if self._tree is not None:
            distance, neighbour = self._tree.query(task.astype(np.float64))
            if float(distance) ** 2 < best:
                index = int(neighbour)
        return float(self._returns[index])

    def _build(self) -> None:
        self._in_tree = self._count - self._count % self.rebuild_every
        self._tree = KDTree(self._tasks[: self._in_tree]) if self._in_tree else None

    def __getstate__(self) -> dict[str, object]:
        rows = slice(0, self._count)
        return {"every": self.rebuild_every, "tasks": self._tasks[rows], "returns": self._returns[rows]}

    def __setstate__(self, state: dict[str, Array]) -> None:
        self.rebuild_every = int(state["every"])
        self._tasks, self._returns = state["tasks"].copy(), state["returns"].copy()
        self._count = len(self._returns)
        spare = -self._count % self.rebuild_every or self.rebuild_every
        self._tasks = np.concatenate([self._tasks, np.empty((spare, self._tasks.shape[1]))])
        self._returns = np.concatenate([self._returns, np.empty(spare)])
        self._build()


class AbsoluteLearningProgress:
    """Absolute learning progress (ALP) of a task: |its return - the nearest earlier task's return|.

    Source: Portelas et al. 2019, section 4; the search is over the whole history in raw task units.
    """

    MINIMUM_HISTORY = 5  # number of initial tasks whose ALP is 0 (original release; not given in the paper)

    def __init__(self, size: int) -> None:
        self._history = NearestReturn(size)

    def __call__(self, task: Task, episodic_return: float) -> float:
        """Return the ALP of an episode, and store the episode."""
        progress = 0.0
        if len(self._history) > self.MINIMUM_HISTORY:
            progress = abs(episodic_return - self._history.nearest(task))
        self._history.add(task, episodic_return)
        return progress


@dataclass
class ALPGMM(MixtureTeacher):
    """Teacher that samples a Gaussian mixture where the absolute learning progress of recent tasks is high.

    Absolute learning progress (ALP) is a further coordinate of each task; a component is chosen in proportion
    to its mean ALP.

    Sources: Portelas et al. 2019, algorithm 1; paper, appendix A and table of hyper-parameters.
    """

    algorithm_version: ClassVar[int | None] = 1

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        """Start with an empty history."""
        super().start(space, knowledge, rng)
        self.learning_progress_ = AbsoluteLearningProgress(space.size)

    def measure(self, episode: Episode) -> tuple[float]:
        """Return the ALP of `episode`, and store the episode."""
        return (self.learning_progress_(episode.task, episode.episodic_return),)

    def progress_of(self, mixture: Mixture) -> Array:
        """Return the mean ALP (k,) of the components."""
        return mixture.means[:, -1].clip(min=0)
