"""The experiments that have a script: which matrices each consists of, and who runs them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from tma_ray.benchmark.grids import TEACHER_GRIDS
from tma_ray.benchmark.lite_1 import LITE_1_SIZE, LITE_1_STAGES, LITE_1_TEACHERS
from tma_ray.benchmark.matrices import (
    CASE_STUDIES,
    MATRICES,
    ORIGINAL_SPACE,
    PARKOUR,
    PPO_SEARCH,
    STUMP_TRACKS_CHALLENGES,
    TEACHER_SEARCH,
    Matrix,
)
from tma_ray.benchmark.tiers import SIZES, Size, Tier
from tma_ray.part_names import nearest

TEACHERS = ("random", *sorted(TEACHER_GRIDS))
"""The teachers that the paper compares."""


@dataclass(frozen=True)
class Experiment:
    """One script's worth of runs.

    Attributes:
        name: of the experiment, its script and its campaign.
        title: what it is about, in a few words.
        matrices: what is run.
        teachers: who runs what the matrices leave open; empty where the user must say.
        read_at: share of the budget after which its tables are read.
        searches: whether its result is the best point of each grid, not a ranking of teachers.
        stages: matrices that are run before others, by the name of the part that they are.
        size: intervals of its runs; None of a field leaves the paper's.
    """

    name: str
    title: str
    matrices: tuple[Matrix, ...]
    teachers: tuple[str, ...] = TEACHERS
    read_at: float = 1.0
    searches: bool = False
    stages: Mapping[str, tuple[Matrix, ...]] = field(default_factory=dict)
    size: Size = field(default_factory=Size)

    def size_at(self, tier: Tier) -> Size:
        """Returns what is run of it at `tier`; the largest is all of it."""
        return self.size if tier is Tier.PAPER else SIZES[tier]

    def stage(self, name: str | None) -> tuple[Matrix, ...]:
        """Returns the matrices of a stage, all for None.

        Raises:
            ValueError: it has no such stage.
        """
        if name is None:
            return self.matrices
        if name not in self.stages:
            known = ", ".join(self.stages) or "none"
            raise ValueError(f"{self.name} has no stage {name!r}; known: {known}")
        return self.stages[name]


EXPERIMENTS: tuple[Experiment, ...] = (
    Experiment(
        "stump_tracks_challenges",
        "Stump Tracks: the original space and five challenges",
        (ORIGINAL_SPACE, *STUMP_TRACKS_CHALLENGES),
    ),
    Experiment("parkour", "Parkour: walking, swimming, climbing", PARKOUR),
    Experiment("case_studies", "Climbing, expert knowledge, ADR, students that forget", CASE_STUDIES),
    Experiment(
        "sample_efficiency",
        "The five challenges after a quarter of the budget",
        STUMP_TRACKS_CHALLENGES,
        read_at=0.25,
    ),
    Experiment("hyperparameter_search", "Hyper-parameters of every teacher", TEACHER_SEARCH, searches=True),
    Experiment("ppo_search", "Hyper-parameters of PPO", (PPO_SEARCH,), searches=True),
    Experiment("full_benchmark", "Everything that is compared: Stump Tracks and Parkour", MATRICES),
    Experiment("compare_new_teacher", "The full benchmark for teachers of your own", MATRICES, teachers=()),
    Experiment(
        "lite_1",
        "The release lite-1: all teachers with PPO",
        tuple(matrix for stage in LITE_1_STAGES.values() for matrix in stage),
        LITE_1_TEACHERS,
        stages=LITE_1_STAGES,
        size=LITE_1_SIZE,
    ),
)
"""Sample efficiency is read from the runs of the challenges: where those are done, it runs nothing."""


def find_experiment(name: str) -> Experiment:
    """Returns the experiment called `name`.

    Raises:
        ValueError: there is none; the message holds the nearest match.
    """
    known = {experiment.name: experiment for experiment in EXPERIMENTS}
    if name not in known:
        hint = nearest(name, known)
        raise ValueError(f"no experiment {name!r}: {hint}known: {', '.join(known)}")
    return known[name]
