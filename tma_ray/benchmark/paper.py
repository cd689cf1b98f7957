"""The paper's tables as data: results, never pooled with ours, and the knowledge that teachers require."""

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Final

from tma_ray.tasks import KnowledgeLevel

PAPER_STEPS: Final = 20_000_000
"""The paper's budget of a run, in environment steps."""

RESULTS = Path(__file__).parent / "paper_results.csv"


@dataclass(frozen=True)
class PaperResult:
    """One entry of the paper's tables of results: mastered test tasks after 20 million steps.

    Attributes:
        environment: name in the environment registry.
        challenge: name of a challenge of that environment.
        expert_knowledge: level the teacher was told.
        embodiments: names of the bodies that are pooled.
        students: names of the students that are pooled.
        teacher: name in the teacher registry.
        seeds: runs behind the numbers.
        mean: mastered tasks, in per cent.
        std: standard deviation over the runs, in percentage points.
        doubt: reason why the entry may be a slip of the paper; empty for most.
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
    """Return every entry of the paper's tables on Stump Tracks and Parkour, in its order."""
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
        initial_distribution: distribution of the first tasks.
        target_distribution: distribution of the last tasks.
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
