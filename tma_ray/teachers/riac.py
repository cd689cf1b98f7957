"""RIAC (Baranes and Oudeyer 2009, in the form of Portelas et al. 2019)."""

import math
from array import array
from collections import deque
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tma_ray.support.validation import check_at_least, check_positive, check_shares
from tma_ray.tasks import Episode, ExpertKnowledge, ScoredBox, Task, TaskSpace, TeacherUpdate
from tma_ray.teachers.base import Teacher
from tma_ray.teachers.numerics import Array, draw_in_box, draw_in_proportion


class Cut(NamedTuple):
    """Cut across `dimension`, with tasks of at most the float32 `threshold` on the left."""

    dimension: int
    threshold: float


@dataclass(frozen=True)
class Split:
    """Cut of a region, with the indices of the two resulting regions."""

    cut: Cut
    left: int
    right: int


class Region:
    """Closed box of float32 tasks, with the latest episodes in it.

    Attributes:
        bounds: lower and upper corner (2, d), float32 values.
        tasks: latest `capacity` tasks, oldest first.
        returns: episodic returns of these tasks.
        split: division into two parts, if any.
    """

    def __init__(self, bounds: Array, capacity: int) -> None:
        self.bounds = bounds
        self.tasks: deque[Task] = deque(maxlen=capacity)
        self.returns: deque[float] = deque(maxlen=capacity)
        self.split: Split | None = None
        self._origin = 0.0
        self._sums: deque[float] = deque([0.0], maxlen=capacity + 1)

    def __len__(self) -> int:
        return len(self.returns)

    @property
    def full(self) -> bool:
        """True if the region holds `capacity` episodes."""
        return len(self.returns) == self.returns.maxlen

    @property
    def progress(self) -> float:
        """Absolute learning progress: |mean return of the later half - mean return of the earlier half|.

        An odd number gives the earlier half one more; up to 2 episodes make no progress. Running sums keep
        the cost constant.
        """
        count = len(self.returns)
        if count <= 2:
            return 0.0
        later = count // 2
        middle = self._sums[-1 - later]
        return abs((self._sums[-1] - middle) / later - (middle - self._sums[0]) / (count - later))

    def add(self, task: Task, episodic_return: float) -> None:
        """Append an episode, replacing the oldest one if the region is full."""
        if not self.returns:
            self._origin = episodic_return  # subtracted so that equal returns give a progress of exactly 0
        self.tasks.append(task)
        self.returns.append(episodic_return)
        self._sums.append(self._sums[-1] + (episodic_return - self._origin))

    def forget(self, count: int) -> None:
        """Drop the oldest `count` episodes."""
        for _ in range(count):
            self.tasks.popleft()
            self.returns.popleft()
            self._sums.popleft()

    def worst_task(self) -> Task:
        """Return the oldest of the tasks with the lowest return."""
        return self.tasks[int(np.argmin(self.returns))]

    def parts(self, cut: Cut) -> tuple["Region", "Region"]:
        """Return the regions to the left and right of `cut`, with their episodes."""
        capacity = self.returns.maxlen
        assert capacity is not None
        left, right = Region(self.bounds.copy(), capacity), Region(self.bounds.copy(), capacity)
        left.bounds[1, cut.dimension] = cut.threshold
        right.bounds[0, cut.dimension] = np.nextafter(np.float32(cut.threshold), np.float32(np.inf))
        for task, episodic_return in zip(self.tasks, self.returns, strict=True):
            (left if task[cut.dimension] <= cut.threshold else right).add(task, episodic_return)
        return left, right


def best_cut(
    region: Region, attempts: int, fewest: int, smallest: Array, rng: np.random.Generator
) -> Cut | None:
    """Return the highest-scoring of `attempts` random cuts of `region`, or None if none is valid.

    The score of a cut is |ALP left - ALP right| times the numbers of episodes left and right (Portelas et
    al. 2019, appendix; Baranes and Oudeyer 2009). Each part must keep at least the `fewest` episodes and the
    `smallest` sides (d,), in task units.
    """
    tasks = np.array(region.tasks)
    dimensions, thresholds = random_cuts(region.bounds, tasks, attempts, fewest, rng)
    if not len(dimensions):
        return None
    left = (tasks[:, dimensions] <= thresholds).T
    scores = cut_scores(left, np.array(region.returns))
    sides = np.abs(thresholds - region.bounds[:, dimensions]).min(axis=0)
    scores[sides < smallest[dimensions]] = -1
    best = int(np.argmax(scores))
    return Cut(int(dimensions[best]), float(thresholds[best])) if scores[best] >= 0 else None


def random_cuts(
    bounds: Array, tasks: Task, count: int, fewest: int, rng: np.random.Generator
) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
    """Return the dimensions and thresholds of `count` random cuts, empty if there is no valid cut.

    Cuts are uniform in the box `bounds` (2, d), given that both parts keep at least the `fewest`
    of the tasks (n, d). Such thresholds lie between two order statistics.
    """
    ordered = np.sort(tasks, axis=0)
    least, most = ordered[fewest - 1], np.nextafter(ordered[-fewest], np.float32(-np.inf))
    room = (most.astype(np.float64) - least).clip(min=0)
    width = bounds[1] - bounds[0]
    chances = np.where(width > 0, room / np.where(width > 0, width, 1.0), 0.0)
    if not chances.any():
        return np.empty(0, dtype=np.intp), np.empty(0, dtype=np.float32)
    dimensions = rng.choice(len(room), size=count, p=chances / chances.sum())
    thresholds = least[dimensions] + rng.random(count) * room[dimensions]
    return dimensions, thresholds.astype(np.float32)


def cut_scores(left: NDArray[np.bool_], returns: Array) -> Array:
    """Return the scores (c,) of cuts, given masks `left` (c, n) of the episodes in their left parts."""
    populations = left.sum(axis=1) * (~left).sum(axis=1)
    difference = _progress(left, returns) - _progress(~left, returns)
    scores: Array = populations * np.abs(difference)
    return scores


def _progress(members: NDArray[np.bool_], returns: Array) -> Array:
    """Return the learning progress (c,) of parts, given masks of their episodes `members` (c, n)."""
    count = members.sum(axis=1)
    later = count // 2
    earlier = count - later
    is_later = members & (members.cumsum(axis=1) > earlier[:, None])
    gains = returns - returns[0]
    later_mean = np.where(is_later, gains, 0.0).sum(axis=1) / later.clip(min=1)
    earlier_mean = np.where(members & ~is_later, gains, 0.0).sum(axis=1) / earlier.clip(min=1)
    return np.where(count > 2, np.abs(later_mean - earlier_mean), 0.0)


KEPT_BY_PARTS = 20  # ratio of a region's capacity to the fewest episodes in a part (original release)
FORGOTTEN = 4  # ratio of a region's capacity to the episodes dropped without a valid cut (as above)


@dataclass
class RIAC(Teacher):
    """Teacher that samples regions of tasks in proportion to their absolute learning progress (ALP).

    A full region is cut in two where the parts differ most in ALP. A task is uniform in a region, chosen by
    ALP among all, divided ones included, or uniform over the task space, or a mutation of the task of lowest
    return in such a region.

    Sources: Baranes and Oudeyer 2009; Portelas et al. 2019, appendix; paper, appendix A and table of
    hyper-parameters. In the original release the score of a cut omits the numbers of episodes, regions are
    cut at 151 episodes, and mutated tasks are lost if a dimension has no width.

    Attributes:
        region_capacity: most episodes in a region, at which it is cut (paper: max_s).
        split_attempts: random cuts among which the best is chosen (paper: n).
        smallest_side: smallest side of a region as a share of each dimension's range (paper: min_d).
        explore: share of tasks uniform over the space, in [0, 1].
        mutate: share of mutated tasks, in [0, 1].
        mutation_std: standard deviation of a mutation, in units of each dimension.
    """

    overlapping: ClassVar[bool] = True
    algorithm_version: ClassVar[int | None] = 1

    region_capacity: int = 150
    split_attempts: int = 75
    smallest_side: float = 0.1
    explore: float = 0.2
    mutate: float = 0.1
    mutation_std: float = 0.1

    def __post_init__(self) -> None:
        check_at_least(self, 4, "region_capacity")
        check_at_least(self, 1, "split_attempts")
        check_positive(self, "smallest_side")
        check_shares(self, "smallest_side")
        if min(self.explore, self.mutate) < 0 or self.explore + self.mutate > 1:
            raise ValueError(
                f"explore = {self.explore} and mutate = {self.mutate} are shares of the tasks; "
                f"expected them in [0, 1] with a sum of at most 1"
            )
        check_at_least(self, 0, "mutation_std")

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        """Start with the task space as one empty region."""
        super().start(space, knowledge, rng)
        root = Region(np.array([space.low, space.high], dtype=np.float64), self.region_capacity)
        self.regions_ = [root]
        self.progress_ = array("d", [0.0])
        self.episodes_since_log_ = 0

    def sample(self) -> Task:
        """Return a task (d,) that is uniform in a chosen region, uniform over the space, or mutated."""
        strategy = self.rng.random()
        if strategy < self.mutate:
            region = self._draw_region(self.rng)
            if not len(region):
                return self.space.sample(self.rng)
            mutated = self.rng.normal(region.worst_task(), self.mutation_std)
            return self.space.clip(np.clip(mutated, *region.bounds))
        if strategy < self.mutate + self.explore:
            return self.space.sample(self.rng)
        return self._exploit(self.rng)

    def observe(self, episode: Episode) -> None:
        """Store the episode in all regions that contain its task, and cut the smallest if it is full."""
        task = episode.task.copy()
        path = self._path(task)
        for index in path:
            self.regions_[index].add(task, episode.episodic_return)
            self.progress_[index] = self.regions_[index].progress
        if self.regions_[path[-1]].full:
            self._cut(path[-1])
        self.episodes_since_log_ += 1
        # at most one box per episode on average, to limit the size of the log
        if self.episodes_since_log_ >= max(self.region_capacity, len(self.regions_)):
            self.episodes_since_log_ = 0
            parts = list(zip(self.regions_, self.progress_, strict=True))
            boxes = tuple(ScoredBox(r.bounds[0], r.bounds[1], progress) for r, progress in parts)
            whole = [progress for region, progress in parts if region.split is None]
            scalars = {"undivided_regions": float(len(whole)), "mean_progress": float(np.mean(whole))}
            self.log(TeacherUpdate(boxes=boxes, scalars=scalars))

    def probe(self, count: int) -> Task:
        """Return `count` tasks (count, d), uniform in regions chosen by ALP."""
        rng = self.probe_rng()
        return np.stack([self._exploit(rng) for _ in range(count)])

    def _path(self, task: Task) -> list[int]:
        """Return the indices of the regions that contain `task`, from the task space to the smallest."""
        path = [0]
        while (split := self.regions_[path[-1]].split) is not None:
            dimension, threshold = split.cut
            path.append(split.left if task[dimension] <= threshold else split.right)
        return path

    def _cut(self, index: int) -> None:
        region = self.regions_[index]
        fewest = math.ceil(self.region_capacity / KEPT_BY_PARTS)
        smallest = self.smallest_side * self.space.width
        cut = best_cut(region, self.split_attempts, fewest, smallest, self.rng)
        if cut is None:
            region.forget(self.region_capacity // FORGOTTEN)
            self.progress_[index] = region.progress
            return
        region.split = Split(cut, left=len(self.regions_), right=len(self.regions_) + 1)
        for part in region.parts(cut):
            self.regions_.append(part)
            self.progress_.append(part.progress)

    def _draw_region(self, rng: np.random.Generator) -> Region:
        return self.regions_[draw_in_proportion(self.progress_, rng)]

    def _exploit(self, rng: np.random.Generator) -> Task:
        return draw_in_box(self.space, self._draw_region(rng).bounds, rng)
