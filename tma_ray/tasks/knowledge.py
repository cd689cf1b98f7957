"""Expert knowledge: the facts about the task space that a teacher gets before it starts."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tma_ray.commands.arguments import check_finite, check_kind
from tma_ray.tasks.episode import MASTERY_RETURN
from tma_ray.tasks.shuffled_space import ShuffledSpace
from tma_ray.tasks.space import Task, TaskSpace

INITIAL_STD_SHARE = 0.1
"""Standard deviation of the initial Gaussian as a share of each range (paper, appendix C)."""

TARGET_STD_SHARE = 0.25
"""Standard deviation of the target Gaussian as a share of each range (paper, appendix C)."""

CONSTANT_DIMENSION_VARIANCE = 1e-6
"""Variance given to dimensions without width, where a share of the range would be singular."""


class KnowledgeLevel(StrEnum):
    """The paper's three amounts of expert knowledge, in rising order."""

    NONE = "none"
    LOW = "low"
    HIGH = "high"

    @classmethod
    def _missing_(cls, value: object) -> KnowledgeLevel:
        raise ValueError(f"expert knowledge {value!r}: expected {', '.join(cls)}")

    @property
    def rank(self) -> int:
        """Position in the order none < low < high."""
        return list(KnowledgeLevel).index(self)


@dataclass(frozen=True, eq=False)
class Gaussian:
    """An axis-aligned Gaussian over tasks: mean (d,) and variance (d,), in task units."""

    mean: NDArray[np.float64]
    variance: NDArray[np.float64]

    def sample(self, space: TaskSpace, rng: np.random.Generator, count: int | None = None) -> Task:
        """Returns one task (d,), or `count` of them (count, d), clipped to `space`."""
        size = None if count is None else (count, self.mean.size)
        return space.clip(rng.normal(self.mean, np.sqrt(self.variance), size=size))


@dataclass(frozen=True, eq=False)
class ExpertKnowledge:
    """Knowledge that an expert gives to a teacher (paper, appendix C, expert knowledge setups).

    Attributes:
        level: how much is known.
        mastery_threshold: episodic return over which a task counts as mastered; None at level none.
        initial: where to start; informative at level high, else placed at random over the space.
        target: where to end; always the wide default, since no task-specific target is known.
    """

    level: KnowledgeLevel
    mastery_threshold: float | None
    initial: Gaussian
    target: Gaussian


def expert_knowledge(
    level: KnowledgeLevel,
    space: TaskSpace,
    placement: np.random.Generator,
    easy_task: ArrayLike | None = None,
    mastery_threshold: float = MASTERY_RETURN,
    landscape: ShuffledSpace | None = None,
) -> ExpertKnowledge:
    """Returns the knowledge of `level` about `space`.

    Args:
        level: how much is told.
        space: the space the teacher works in.
        placement: draws the mean of the initial Gaussian below level high. It is drawn at every
            level, so that what follows does not depend on the level.
        easy_task: an easy task (d,) of the world, the initial mean at level high.
        mastery_threshold: told from level low on.
        landscape: where the teacher's tasks lie in the world if its space is shuffled. The easy task is
            told as the teacher's task that leads to it; variances stay as they are.

    Raises:
        ValueError: level high without an easy task, or with one outside the space.
    """
    level = KnowledgeLevel(level)
    check_kind("placement", placement, np.random.Generator, "a Generator of numpy's")
    check_finite("mastery_threshold", mastery_threshold)
    mean = space.low + placement.random(space.size) * space.width
    if level is KnowledgeLevel.HIGH:
        if easy_task is None:
            raise ValueError(
                "expert knowledge 'high' needs an easy task, and this space declares none; use 'low'"
            )
        if not space.contains(easy_task):
            raise ValueError(f"the easy task {np.asarray(easy_task).tolist()} lies outside the task space")
        told = easy_task if landscape is None else landscape.from_world(easy_task)
        mean = np.asarray(told, dtype=np.float64)
    return ExpertKnowledge(
        level=level,
        mastery_threshold=None if level is KnowledgeLevel.NONE else mastery_threshold,
        initial=Gaussian(mean, _variance(space, INITIAL_STD_SHARE)),
        target=Gaussian(space.centre, _variance(space, TARGET_STD_SHARE)),
    )


def _variance(space: TaskSpace, std_share: float) -> NDArray[np.float64]:
    return np.where(space.width > 0, (std_share * space.width) ** 2, CONSTANT_DIMENSION_VARIANCE)
