"""The expert knowledge that each teacher requires: the paper's table of its teachers, as data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum


class Requirement(StrEnum):
    """The use that a teacher makes of a piece of expert knowledge."""

    REQUIRED = "required"
    OPTIONAL = "optional"
    IGNORED = "ignored"


@dataclass(frozen=True)
class KnowledgeRequirements:
    """The use that a teacher makes of each piece of `tma_ray.tasks.ExpertKnowledge`.

    The distributions are there at every level, the initial one placed at random unless an expert knows
    better, so that a teacher that requires one still runs without knowledge. The range of returns is told
    from level low on: a teacher that requires it cannot run below.

    Attributes:
        initial_distribution: where to start.
        target_distribution: where to end.
        mastery_range: the returns between which a task is being learned, or the one from which on it is
            mastered.
    """

    initial_distribution: Requirement
    target_distribution: Requirement
    mastery_range: Requirement


REQUIRED, OPTIONAL, IGNORED = Requirement

KNOWLEDGE_REQUIREMENTS: Mapping[str, KnowledgeRequirements] = {
    "random": KnowledgeRequirements(IGNORED, IGNORED, IGNORED),
    "adr": KnowledgeRequirements(REQUIRED, IGNORED, REQUIRED),
    "alp_gmm": KnowledgeRequirements(OPTIONAL, IGNORED, IGNORED),
    "covar_gmm": KnowledgeRequirements(OPTIONAL, IGNORED, IGNORED),
    "goal_gan": KnowledgeRequirements(OPTIONAL, IGNORED, REQUIRED),
    "riac": KnowledgeRequirements(IGNORED, IGNORED, IGNORED),
    "setter_solver": KnowledgeRequirements(IGNORED, OPTIONAL, REQUIRED),
    "spdl": KnowledgeRequirements(REQUIRED, REQUIRED, IGNORED),
}
"""By name of the teacher (paper, section 3); Random, which is not among them there, uses nothing."""
