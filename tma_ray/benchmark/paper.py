"""The paper's result tables as data: facts about another engine, set beside results and never pooled."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from tma_ray.tasks import KnowledgeLevel

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
        doubt: why the entry may be a slip of the paper; empty for most.
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
    """Returns every entry of the paper's tables on Stump Tracks and Parkour, in its order."""
    with RESULTS.open(newline="") as file:
        return tuple(_result(row) for row in csv.DictReader(file))


def _result(row: dict[str, str]) -> PaperResult:
    return PaperResult(
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
