"""SPDL, self-paced deep reinforcement learning (Klink et al. 2020)."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from tma_ray.tasks import (
    Episode,
    ExpertKnowledge,
    Gaussian,
    KnowledgeLevel,
    Query,
    QueryKind,
    Task,
    TaskSpace,
    TeacherUpdate,
    WeightedGaussian,
)
from tma_ray.teachers.base import Teacher
from tma_ray.teachers.numerics.full_gaussian import FullGaussian
from tma_ray.teachers.numerics.self_paced_update import self_paced_update
from tma_ray.teachers.numerics.unit_box import UnitBox

MOST_CONTEXTS = 1000
"""Latest episodes that an update learns from (as in the original release; the paper is silent)."""

LARGEST_PENALTY = 1e5
"""Where the distribution equals its target, alpha has no finite value (as in the original release)."""


@dataclass
class SPDL(Teacher):
    """Moves a Gaussian from an initial to a target distribution, at the pace of the student's values.

    Every update maximises the value of the initial states that the tasks led to, minus a penalty for
    the divergence from the target, within a bound on the divergence from the old Gaussian. The
    penalty's weight alpha keeps it a constant proportion of the mean discounted return.

    Sources: Klink et al. 2020, algorithm 1; paper, appendix A (Self-Paced), appendix C (expert
    knowledge) and table of hyper-parameters. An update happens at the first episode end after its
    step is due; the original release updates within an episode, on the very step, if an episode has ended
    since the last one.

    The preset "release" has the values of the original release's launch files where they differ from the
    paper's table: twice as many updates, each within an eighth of the divergence, and five times the
    penalty, from the eleventh update on.

    Attributes:
        first_update: environment steps before the first update (paper: n_OFFSET).
        update_every: environment steps between two updates (paper: n_STEP).
        updates_without_penalty: first updates with alpha = 0 (paper: K_alpha).
        penalty_share: penalty as a share of the mean discounted return (paper: zeta).
        most_divergence: bound on KL(old || new) of an update, in nats (paper: epsilon).
    """

    algorithm_version: ClassVar[int | None] = 1
    knowledge_levels: ClassVar[tuple[KnowledgeLevel, ...]] = (KnowledgeLevel.NONE, KnowledgeLevel.HIGH)
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "release": {
            "update_every": 50_000,
            "updates_without_penalty": 10,
            "penalty_share": 0.25,
            "most_divergence": 0.1,
        }
    }

    first_update: int = 200_000
    update_every: int = 100_000
    updates_without_penalty: int = 0
    penalty_share: float = 0.05
    most_divergence: float = 0.8

    def __post_init__(self) -> None:
        if self.first_update < 0 or self.update_every < 1:
            raise ValueError(
                f"first_update = {self.first_update} and update_every = {self.update_every} are numbers "
                f"of steps; expected at least 0 and at least 1"
            )
        if self.updates_without_penalty < 0:
            raise ValueError(f"updates_without_penalty = {self.updates_without_penalty}: expected at least 0")
        if self.penalty_share < 0:
            raise ValueError(f"penalty_share = {self.penalty_share}: expected at least 0")
        if not self.most_divergence > 0:
            raise ValueError(f"most_divergence = {self.most_divergence}: expected a bound over 0")

    def start(self, space: TaskSpace, knowledge: ExpertKnowledge, rng: np.random.Generator) -> None:
        """Starts at the initial Gaussian."""
        super().start(space, knowledge, rng)
        self._box = UnitBox(space)
        self._target = self._scaled(knowledge.target)
        self.distribution_ = self._scaled(knowledge.initial)
        self.contexts_: deque[tuple[Task, NDArray[np.float32]]] = deque(maxlen=MOST_CONTEXTS)
        self.discounted_returns_: list[float] = []
        self.updates_ = 0
        self.next_update_ = self.first_update
        self._log({})

    def sample(self) -> Task:
        """Returns a task (d,) of the current Gaussian, clipped to the space."""
        task: Task = self._draw(self.rng, 1)[0]
        return task

    def observe(self, episode: Episode) -> Query | None:
        """Stores the episode; asks for the values of all initial states when an update is due."""
        self.contexts_.append((episode.task, episode.initial_observation))
        self.discounted_returns_.append(episode.discounted_return)
        if episode.step < self.next_update_:
            return None
        passed = (episode.step - self.first_update) // self.update_every
        self.next_update_ = self.first_update + (passed + 1) * self.update_every
        return Query(QueryKind.STATE_VALUES, np.stack([observation for _, observation in self.contexts_]))

    def answer(self, answer: NDArray[np.float64]) -> None:
        """Updates the Gaussian with the values (n,) of the stored episodes, and forgets them."""
        old, performance = self.distribution_, float(np.mean(self.discounted_returns_))
        penalty = self._penalty(performance)
        contexts = self._box.normalise(np.stack([task for task, _ in self.contexts_]))
        bound = self.most_divergence
        self.distribution_ = self_paced_update(old, self._target, contexts, answer, penalty, bound)
        self.updates_ += 1
        self.contexts_.clear()
        self.discounted_returns_.clear()
        self._log(
            {
                "alpha": penalty,
                "mean_value": float(answer.mean()),
                "mean_discounted_return": performance,
                "step_divergence": old.divergence(self.distribution_),
            }
        )

    def probe(self, count: int) -> Task:
        """Returns `count` tasks (count, d) of the current Gaussian."""
        return self._draw(self.probe_rng(), count)

    def _draw(self, rng: np.random.Generator, count: int) -> Task:
        return self._box.denormalise(self.distribution_.draw(rng, count))

    def _penalty(self, performance: float) -> float:
        if self.updates_ < self.updates_without_penalty:
            return 0.0
        wanted = self.penalty_share * performance
        if wanted <= 0:
            return 0.0
        return wanted / max(self.distribution_.divergence(self._target), wanted / LARGEST_PENALTY)

    def _scaled(self, gaussian: Gaussian) -> FullGaussian:
        width = self.space.width[self._box.free]
        deviations = np.sqrt(gaussian.variance[self._box.free]) / width
        return FullGaussian(self._box.normalise(gaussian.mean), np.diag(deviations))

    def _log(self, scalars: dict[str, float]) -> None:
        """Logs the Gaussian in task units; constant dimensions keep their value and variance."""
        free, initial = self._box.free, self.knowledge.initial
        scale = self.space.width[free]
        mean, covariance = initial.mean.copy(), np.diag(initial.variance)
        mean[free] = self.space.low[free] + scale * self.distribution_.mean
        factor = scale[:, None] * self.distribution_.factor
        covariance[np.ix_(free, free)] = factor @ factor.T
        target_divergence = self.distribution_.divergence(self._target)
        self.log(
            TeacherUpdate(
                gaussians=(WeightedGaussian(1.0, mean, covariance),),
                scalars={**scalars, "target_divergence": target_divergence},
            )
        )
