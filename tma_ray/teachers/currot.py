"""CURROT, a curriculum by constrained optimal transport (Klink et al. 2022)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tma_ray.tasks import Episode, ExpertKnowledge, KnowledgeLevel, Task, TaskSpace, TeacherUpdate
from tma_ray.teachers.base import Teacher
from tma_ray.teachers.numerics.success_buffer import SuccessBuffer
from tma_ray.teachers.numerics.task_cloud import cloud_gaussian
from tma_ray.teachers.numerics.transport import Performance, Region, assigned, moved
from tma_ray.teachers.numerics.unit_box import UnitBox

Array = NDArray[np.float64]

CANDIDATES, LINE_CANDIDATES = 20, 10
"""Points tried for each particle: in the ball around it, and on the way to its target."""

NARROWEST = 0.005
"""Noise around successes, as a share of the radius of a move (as in the authors' code)."""

JITTER = 1e-3
"""Half width of the uniform noise of a task, as a share of each range (as in the authors' code)."""


@dataclass
class CURROT(Teacher):
    """Moves particles towards a target distribution, as far as the student's returns allow.

    Tasks are particles, drawn at random. Every `update_every` episodes an optimal assignment gives each
    particle a target, drawn uniformly from the space; it moves to the point nearest to that in a ball around
    it, of those where the expected return is at least `least_return`. Where returns are too low, particles go
    to tasks like those that the student has mastered. Expected returns are kernel averages of the latest
    failures and of a buffer of successes.

    Sources: Klink et al. 2022, algorithm 1 and section 4; the authors' code, with their hyper-parameters for
    Stump Tracks.

    Attributes:
        least_return: expected return of a particle at least (paper: delta).
        particles: their number, and the most successes and failures kept.
        update_every: episodes between two updates.
        radius: of a move, as a share of the diagonal of the space (paper: epsilon).
        kernel_width: standard deviation of the kernel of expected returns, as a share of the radius.
    """

    algorithm_version: ClassVar[int | None] = 1
    knowledge_levels: ClassVar[tuple[KnowledgeLevel, ...]] = (KnowledgeLevel.LOW, KnowledgeLevel.HIGH)

    least_return: float = 180.0
    particles: int = 250
    update_every: int = 50
    radius: float = 0.05
    kernel_width: float = 1.0

    def __post_init__(self) -> None:
        for name in ("particles", "update_every"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} = {getattr(self, name)}: expected at least 1")
        for name in ("radius", "kernel_width"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} = {getattr(self, name)}: expected a share over 0")

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        """Draws the particles from the initial Gaussian at high knowledge, else uniformly."""
        super().start(space, knowledge, rng)
        self._box = UnitBox(space)
        self._radius = self.radius * np.sqrt(self._box.size)
        if knowledge.level is KnowledgeLevel.HIGH:
            tasks = knowledge.initial.sample(space, rng, self.particles)
        else:
            tasks = space.sample(rng, self.particles)
        self.particles_ = self._box.normalise(tasks)
        self.successes_ = SuccessBuffer(self._box.size, self.particles, self.least_return)
        self.failures_ = np.empty((0, self._box.size + 1))
        self.latest_ = np.empty((0, self._box.size + 1))

    def sample(self) -> Task:
        """Returns a particle (d,) with a little noise."""
        task: Task = self._draw(self.rng, 1)[0]
        return task

    def observe(self, episode: Episode) -> None:
        """Stores the episode; updates the particles when that is due."""
        row = np.append(self._box.normalise(episode.task), episode.episodic_return)
        self.latest_ = np.vstack([self.latest_, row])
        if len(self.latest_) == self.update_every:
            self._update()

    def probe(self, count: int) -> Task:
        """Returns `count` particles (count, d)."""
        return self._draw(self.probe_rng(), count)

    def _draw(self, rng: np.random.Generator, count: int) -> Task:
        points = self.particles_[rng.integers(len(self.particles_), size=count)]
        return self._box.denormalise(points + JITTER * rng.uniform(-1, 1, points.shape))

    def _update(self) -> None:
        count, size = self.particles_.shape
        targets = self.rng.random((count, size))
        points, returns = self.latest_[:, :-1], self.latest_[:, -1]
        left_out = self.successes_.add(points, returns, targets)
        self.failures_ = np.vstack([self.failures_, self.latest_[left_out]])[-count:]
        self.latest_ = self.latest_[:0]
        known = np.vstack([self.failures_[:, :-1], self.successes_.points])
        known_returns = np.append(self.failures_[:, -1], self.successes_.returns)
        performance = Performance(known, known_returns, self.kernel_width * self._radius)
        particles = self._at_successes(performance)
        order = assigned(particles, targets)
        region = Region(self._radius, CANDIDATES, LINE_CANDIDATES)
        self.particles_ = moved(particles, targets[order], performance, self.least_return, region, self.rng)
        self._log(targets[order], float(returns.mean()))

    def _at_successes(self, performance: Performance) -> Array:
        """Returns the particles, of which those that return too little are put where successes are."""
        low = performance(self.particles_) < self.least_return
        if not low.any():
            return self.particles_
        successes = self.successes_.draw(self.rng, len(self.particles_), NARROWEST * self._radius)
        return np.where(low[:, None], successes[assigned(self.particles_, successes)], self.particles_)

    def _log(self, targets: Array, mean_return: float) -> None:
        distance = float(np.sqrt(((self.particles_ - targets) ** 2).sum(axis=1).mean()))
        scalars = {
            "target_distance": distance,
            "mean_return": mean_return,
            "successes": float((self.successes_.returns >= self.least_return).sum()),
        }
        gaussian = cloud_gaussian(self.space, self._box.denormalise(self.particles_))
        self.log(TeacherUpdate(gaussians=(gaussian,), scalars=scalars))
