"""Tables of the paper as data: results and the teachers' knowledge requirements."""

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Final

from tma_ray.tasks import KnowledgeLevel

PAPER_STEPS: Final = 20_000_000  # budget of each run in the paper, in environment steps

RESULTS = Path(__file__).parent / "paper_results.csv"


@dataclass(frozen=True)
class PaperResult:
    """Entry of the paper's tables: percentage of mastered test tasks after 20 million steps.

    Attributes:
        expert_knowledge: level of expert knowledge.
        embodiments: names of the pooled bodies.
        students: names of the pooled students.
        mean: mean percentage of mastered tasks.
        std: standard deviation over the runs, in percentage points.
        doubt: reason why the entry may be an error of the paper, usually empty.
    """

    environment: str
    challenge: str
    expert_knowledge: KnowledgeLevel
    embodiments: tuple[str, ...]
    students: tuple[str, ...]
    teacher: str
    seeds: int
    mean: float
    std: float
    doubt: str


@cache
def paper_results() -> tuple[PaperResult, ...]:
    """Return the entries of the paper's tables on Stump Tracks and Parkour, in order."""
    with RESULTS.open(newline="") as file:
        return tuple(
            PaperResult(
                environment=row["environment"],
                challenge=row["challenge"],
                expert_knowledge=KnowledgeLevel(row["expert_knowledge"]),
                embodiments=tuple(row["embodiments"].split("+")),
                students=tuple(row["students"].split("+")),
                teacher=row["teacher"],
                seeds=int(row["seeds"]),
                mean=float(row["mean"]),
                std=float(row["std"]),
                doubt=row["doubt"],
            )
            for row in csv.DictReader(file)
        )


class Requirement(StrEnum):
    """Degree to which a teacher requires a part of expert knowledge."""

    REQUIRED = "required"
    OPTIONAL = "optional"
    IGNORED = "ignored"


@dataclass(frozen=True)
class KnowledgeRequirements:
    """Requirements of a teacher for the parts of `tma_ray.tasks.ExpertKnowledge`.

    Distributions exist at every level (the initial one is random without expert knowledge), but teachers that
    require the mastery range cannot run below level low.

    Attributes:
        initial_distribution: distribution of the first tasks.
        target_distribution: distribution of the last tasks.
        mastery_range: returns between which a task is being learned, or above which it is mastered.
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
"""Requirements by teacher (paper, section 3; Random is added)."""
