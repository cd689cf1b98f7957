"""LP-ACRL, a curriculum over grid cells based on learning progress (Li, Li and Hutter 2026)."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tma_ray.support.validation import check_at_least, check_positive
from tma_ray.tasks import Episode, ExpertKnowledge, ScoredBox, Task, TaskSpace, TeacherUpdate
from tma_ray.teachers.base import PAPER_BUDGET, DistributionTeacher, for_budget
from tma_ray.teachers.numerics import UnitBox, draw_in_proportion, softmax


def split_evenly(dimensions: int, most_cells: int) -> tuple[int, ...]:
    """Return nearly equal numbers of cells per dimension, with a product of at most `most_cells`."""
    counts = [1] * dimensions
    while True:
        axis = counts.index(min(counts))
        if math.prod(counts) // counts[axis] * (counts[axis] + 1) > most_cells:
            return tuple(counts)
        counts[axis] += 1


@dataclass
class LPACRL(DistributionTeacher):
    """Teacher that samples grid cells by a softmax of their learning progress between stages.

    The learning progress of a cell in stage j is R_j - R_{j-1}, with R_j the mean return in the cell. The
    next stage draws cells with the probabilities softmax(progress / temperature), and a uniform task of the
    cell. The first stage is uniform. A cell without an episode keeps its mean return, and has progress 0.

    Sources: Li, Li and Hutter 2026 (arXiv:2601.17428), whose formulas of R, progress and probabilities were
    read in others' restatements. Temperature, length of a stage, grid and unvisited cells are our choice.

    Attributes:
        cells: largest number of cells of the grid.
        stage_episodes: episodes of a stage.
        temperature: difference in progress, in units of return, by which a cell is e times as likely (paper:
            beta).
        budget: environment steps of the run, to which `for_budget` fits stage_episodes.
    """

    overlapping: ClassVar[bool] = True
    algorithm_version: ClassVar[int | None] = 1
    single_task: ClassVar[bool] = False

    cells: int = 36
    stage_episodes: int = 500
    temperature: float = 50.0
    budget: int = PAPER_BUDGET

    def __post_init__(self) -> None:
        check_at_least(self, 2, "cells")
        check_at_least(self, 1, "stage_episodes")
        check_positive(self, "temperature")
        for_budget(self.stage_episodes, self.budget)

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        """Start with uniform tasks."""
        super().start(space, knowledge, rng)
        self._box = UnitBox(space)
        self._counts = np.array(split_evenly(self._box.size, self.cells))
        size = int(self._counts.prod())
        self.chances_ = np.full(size, 1 / size)
        self.means_ = np.full(size, np.nan)
        self.sums_, self.visits_ = np.zeros(size), np.zeros(size)
        self.episodes_ = 0

    def draw(self, rng: np.random.Generator, count: int) -> Task:
        """Return `count` tasks (count, d), each uniform in a cell drawn by the current probabilities."""
        return np.stack([self._draw_task(rng) for _ in range(count)])

    def observe(self, episode: Episode) -> None:
        """Add the return to the task's cell, and begin the next stage when this one is over."""
        cell = self.cell_of(episode.task)
        self.sums_[cell] += episode.episodic_return
        self.visits_[cell] += 1
        self.episodes_ += 1
        if self.episodes_ % for_budget(self.stage_episodes, self.budget) == 0:
            self._advance()

    def cell_of(self, task: Task) -> int:
        """Return the index of the cell of `task` (d,), in row-major order."""
        indices = (self._box.normalise(task) * self._counts).astype(np.int64)
        inside = np.clip(indices, 0, self._counts - 1)
        return int(np.ravel_multi_index(tuple(inside), tuple(self._counts)))

    def _draw_task(self, rng: np.random.Generator) -> Task:
        corner = np.array(np.unravel_index(draw_in_proportion(self.chances_, rng), tuple(self._counts)))
        task: Task = self._box.denormalise((corner + rng.random(self._box.size)) / self._counts)
        return task

    def _advance(self) -> None:
        visited = self.visits_ > 0
        means = np.divide(self.sums_, self.visits_, out=self.means_.copy(), where=visited)
        progress = np.nan_to_num(means - self.means_)
        self.chances_, self.means_ = softmax(progress, self.temperature), means
        corners = np.stack(np.unravel_index(np.arange(len(progress)), tuple(self._counts)), axis=1)
        lows = self._box.denormalise(corners / self._counts).astype(np.float64)
        highs = self._box.denormalise((corners + 1) / self._counts).astype(np.float64)
        scalars = {
            "largest_progress": float(progress.max()),
            "largest_chance": float(self.chances_.max()),
            "mean_return": float(self.sums_.sum() / self.visits_.sum()),
            "visited_share": float(visited.mean()),
        }
        boxes = tuple(map(ScoredBox, lows, highs, self.chances_.tolist()))
        self.log(TeacherUpdate(boxes=boxes, scalars=scalars))
        self.sums_, self.visits_ = np.zeros_like(self.sums_), np.zeros_like(self.visits_)
