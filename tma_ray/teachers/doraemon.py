"""DORAEMON, domain randomisation via entropy maximisation (Tiboni et al. 2024)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tma_ray.tasks import (
    Episode,
    ExpertKnowledge,
    KnowledgeLevel,
    Task,
    TaskSpace,
    TeacherUpdate,
    WeightedGaussian,
)
from tma_ray.teachers.base import PAPER_STEPS, Teacher, for_budget
from tma_ray.teachers.numerics.beta_product import BetaProduct
from tma_ray.teachers.numerics.entropy_update import EntropyUpdate
from tma_ray.teachers.numerics.task_cloud import CONSTANT_STD
from tma_ray.teachers.numerics.unit_box import UnitBox


@dataclass
class DORAEMON(Teacher):
    """Widens independent Beta distributions as long as the student masters enough of their tasks.

    Every update maximises the entropy, within a bound on the divergence from the old distribution, such that
    the share of mastered tasks is expected to stay at least `least_success`; it is estimated by importance
    sampling from the episodes since the last update. Where no such distribution is near, the one of most
    success is taken. Before the share is reached for the first time, nothing changes.

    Sources: Tiboni et al. 2024, section 4 and appendix; the authors' code.

    Attributes:
        least_success: expected share of mastered tasks at least, in (0, 1) (paper: alpha).
        most_divergence: bound on KL(old || new) of an update, in nats (paper: epsilon).
        update_every: environment steps between two updates.
        concentration: both parameters of a Beta distribution at the start, if its mode is in the middle; its
            mode is the mean of the initial Gaussian.
        start_from_wide_uniform: True if it starts uniform, and narrows to what is mastered, where no easy
            task is known (authors' code).
        budget: environment steps of the run, to which `for_budget` fits update_every.
    """

    algorithm_version: ClassVar[int | None] = 1
    knowledge_levels: ClassVar[tuple[KnowledgeLevel, ...]] = (KnowledgeLevel.LOW, KnowledgeLevel.HIGH)

    absent_at_default: ClassVar[frozenset[str]] = frozenset(("start_from_wide_uniform", "budget"))

    least_success: float = 0.5
    most_divergence: float = 0.05
    update_every: int = 100_000
    concentration: float = 100.0
    start_from_wide_uniform: bool = False
    budget: int = PAPER_STEPS

    def __post_init__(self) -> None:
        if not 0 < self.least_success < 1:
            raise ValueError(f"least_success = {self.least_success} is a share; expected it between 0 and 1")
        if not self.most_divergence > 0:
            raise ValueError(f"most_divergence = {self.most_divergence}: expected a bound over 0")
        if self.update_every < 1:
            raise ValueError(f"update_every = {self.update_every}: expected at least 1 environment step")
        if not self.concentration > 1:
            raise ValueError(f"concentration = {self.concentration}: expected over 1, which is uniform")
        for_budget(self.update_every, self.budget)

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        """Starts around the mean of the initial Gaussian, or uniform."""
        super().start(space, knowledge, rng)
        self._box = UnitBox(space)
        mode = np.clip(self._box.normalise(knowledge.initial.mean), 0.0, 1.0)
        wide = self.start_from_wide_uniform and knowledge.level is not KnowledgeLevel.HIGH
        self.distribution_ = BetaProduct.around(mode, 1.0 if wide else self.concentration)
        self.tasks_: list[Task] = []
        self.successes_: list[bool] = []
        self.reached_ = wide
        self.next_update_ = for_budget(self.update_every, self.budget)
        self._log({})

    def sample(self) -> Task:
        """Returns a task (d,) of the present distribution."""
        task: Task = self._draw(self.rng, 1)[0]
        return task

    def observe(self, episode: Episode) -> None:
        """Stores the episode; updates the distribution when that is due."""
        self.tasks_.append(episode.task)
        self.successes_.append(episode.success)
        if episode.step < self.next_update_:
            return
        every = for_budget(self.update_every, self.budget)
        self.next_update_ += every * ((episode.step - self.next_update_) // every + 1)
        self._update()

    def probe(self, count: int) -> Task:
        """Returns `count` tasks (count, d) of the present distribution."""
        return self._draw(self.probe_rng(), count)

    def _draw(self, rng: np.random.Generator, count: int) -> Task:
        return self._box.denormalise(self.distribution_.draw(rng, count))

    def _update(self) -> None:
        old, mastered = self.distribution_, np.array(self.successes_)
        self.reached_ = self.reached_ or bool(mastered.mean() >= self.least_success)
        if self.reached_:
            points = self._box.normalise(np.stack(self.tasks_))
            bounds = self.least_success, self.most_divergence, 2 * self.concentration
            self.distribution_ = EntropyUpdate(old, points, mastered, *bounds).solved()
        self.tasks_, self.successes_ = [], []
        step = old.divergence(self.distribution_)[0]
        self._log({"mastered_share": float(mastered.mean()), "step_divergence": step})

    def _log(self, scalars: dict[str, float]) -> None:
        """Logs the Gaussian of equal mean and variance in task units; constants keep their value."""
        free, scale = self._box.free, self.space.width[self._box.free]
        mean, variance = self.space.centre.copy(), np.full(self.space.size, CONSTANT_STD**2)
        mean[free] = self.space.low[free] + scale * self.distribution_.mean
        variance[free] = scale**2 * self.distribution_.variance
        gaussian = WeightedGaussian(1.0, mean, np.diag(variance))
        entropy = self.distribution_.entropy()[0]
        self.log(TeacherUpdate(gaussians=(gaussian,), scalars={**scalars, "entropy": entropy}))
