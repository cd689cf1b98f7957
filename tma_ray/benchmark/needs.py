"""The expert knowledge that each teacher requires: the paper's table of its teachers, as data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum


class Need(StrEnum):
    """What a teacher makes of a piece of expert knowledge."""

    REQUIRED = "required"
    OPTIONAL = "optional"
    IGNORED = "ignored"


@dataclass(frozen=True)
class KnowledgeNeeds:
    """What a teacher makes of each piece of `tma_ray.tasks.ExpertKnowledge`.

    The distributions are there at every level, the initial one placed at random unless an expert knows
    better, so that a teacher that requires one still runs without knowledge. The range of returns is told
    from level low on: a teacher that requires it cannot run below.

    Attributes:
        initial_distribution: where to start.
        target_distribution: where to end.
        mastery_range: the returns between which a task is being learned, or the one from which on it is
            mastered.
    """

    initial_distribution: Need
    target_distribution: Need
    mastery_range: Need


REQUIRED, OPTIONAL, IGNORED = Need

KNOWLEDGE_NEEDS: Mapping[str, KnowledgeNeeds] = {
    "random": KnowledgeNeeds(IGNORED, IGNORED, IGNORED),
    "adr": KnowledgeNeeds(REQUIRED, IGNORED, REQUIRED),
    "alp_gmm": KnowledgeNeeds(OPTIONAL, IGNORED, IGNORED),
    "covar_gmm": KnowledgeNeeds(OPTIONAL, IGNORED, IGNORED),
    "goal_gan": KnowledgeNeeds(OPTIONAL, IGNORED, REQUIRED),
    "riac": KnowledgeNeeds(IGNORED, IGNORED, IGNORED),
    "setter_solver": KnowledgeNeeds(IGNORED, OPTIONAL, REQUIRED),
    "spdl": KnowledgeNeeds(REQUIRED, REQUIRED, IGNORED),
}
"""By name of the teacher (paper, section 3); Random, which is not among them there, uses nothing."""
