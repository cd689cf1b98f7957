"""Experiment matrices of the paper, and the grids of its hyper-parameter searches."""

import itertools
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tma_ray.benchmark.challenges import find_challenge
from tma_ray.support.component_names import nearest
from tma_ray.tasks import KnowledgeLevel


@dataclass(frozen=True)
class Grid:
    """Grid of hyper-parameters, with the point chosen in the paper.

    Attributes:
        values: values of each hyper-parameter.
        chosen: combination chosen in the paper.

    Raises:
        ValueError: if the chosen combination is not in the grid.
    """

    values: Mapping[str, tuple[Any, ...]]
    chosen: Mapping[str, Any]

    def __post_init__(self) -> None:
        if dict(self.chosen) not in self._combinations():
            raise ValueError(
                f"the choice {dict(self.chosen)} is not in the grid; expected values from {dict(self.values)}"
            )

    def points(self, most: int | None = None) -> tuple[dict[str, Any], ...]:
        """Return the paper's choice and up to `most` - 1 other points spread evenly over the grid."""
        others = [point for point in self._combinations() if point != dict(self.chosen)]
        count = len(others) if most is None else min(max(most - 1, 0), len(others))
        spread = (others[index * len(others) // count] for index in range(count))
        return (dict(self.chosen), *spread)

    def _combinations(self) -> list[dict[str, Any]]:
        combinations = itertools.product(*self.values.values())
        return [dict(zip(self.values, point, strict=True)) for point in combinations]


def _grids() -> dict[str, Grid]:
    """Return the grids in ``grids.toml`` by name of the teacher or student."""
    entries = tomllib.loads((Path(__file__).parent / "grids.toml").read_text(encoding="utf-8"))
    return {
        name: Grid({key: tuple(values) for key, values in entry["values"].items()}, entry["chosen"])
        for name, entry in entries.items()
    }


_GRIDS = _grids()

PPO_GRID = _GRIDS["ppo"]
TEACHER_GRIDS = {name: grid for name, grid in _GRIDS.items() if name != "ppo"}
"""Grids of the paper's searches (appendix on hyper-parameters), for teachers by name."""


@dataclass(frozen=True)
class Matrix:
    """Matrix of all combinations of body, student, level, hyper-parameters and seed on one challenge.

    Teachers skip levels with too little knowledge. Results pool bodies, students and seeds, also of other
    matrices on the same challenge.

    Attributes:
        seeds: seeds of each combination.
        teachers: names in the teacher registry, empty if the user names them.
        steps: budget of each run, None for the default of 20 million.
        test_every: step between evaluated tasks of the test set, 1 for all.
        teacher_grid: hyper-parameters of the teacher to search.
        student_grid: hyper-parameters of the student to search.
        most_points: number of points of each grid, None for all.

    Raises:
        ValueError: if the challenge is unknown.
    """

    name: str
    environment: str
    challenge: str
    embodiments: tuple[str, ...] = ("classic_bipedal",)
    students: tuple[str, ...] = ("sac",)
    levels: tuple[KnowledgeLevel, ...] = tuple(KnowledgeLevel)
    seeds: tuple[int, ...] = tuple(range(32))
    teachers: tuple[str, ...] = ()
    steps: int | None = None
    test_every: int = 1
    teacher_grid: Grid | None = None
    student_grid: Grid | None = None
    most_points: int | None = None

    def __post_init__(self) -> None:
        find_challenge(self.environment, self.challenge)

    def taught_by(self, teachers: Sequence[str]) -> "Matrix":
        """Return the matrix with `teachers`, unless it defines its own."""
        return self if self.teachers else replace(self, teachers=tuple(teachers))

    def points(self) -> tuple[tuple[dict[str, Any], dict[str, Any]], ...]:
        """Return all points of the grids, as hyper-parameters of teacher and student ({} without a grid)."""
        teachers = self.teacher_grid.points(self.most_points) if self.teacher_grid else ({},)
        students = self.student_grid.points(self.most_points) if self.student_grid else ({},)
        return tuple(itertools.product(teachers, students))


def _parkour(locomotion: str, embodiment: str, first_seed: int) -> Matrix:
    """Return the Parkour matrix of one body, with 16 seeds of its own."""
    return Matrix(
        name=f"parkour_{locomotion}",
        environment="parkour",
        challenge="original",
        embodiments=(embodiment,),
        levels=(KnowledgeLevel.LOW,),
        seeds=tuple(range(first_seed, first_seed + 16)),
    )


ORIGINAL_SPACE = Matrix("original", "stump_tracks", "original")  # original space of Stump Tracks

STUMP_TRACKS_CHALLENGES: tuple[Matrix, ...] = (
    Matrix("mostly_unfeasible", "stump_tracks", "mostly_unfeasible"),
    Matrix("mostly_trivial", "stump_tracks", "mostly_trivial"),
    Matrix("forgetting_student", "stump_tracks", "forgetting_student"),
    Matrix("rugged_difficulty", "stump_tracks", "rugged_difficulty"),
    Matrix(
        "diverse_students",
        "stump_tracks",
        "diverse_students",
        embodiments=("short_bipedal", "spider"),
        students=("sac", "ppo"),
    ),
)
"""The five challenges of the paper's appendix C, 768 runs per teacher: 3 levels x (4 + 4) combinations (the
last challenge has four) x 32 seeds."""

PARKOUR: tuple[Matrix, ...] = (
    _parkour("walking", "classic_bipedal", 0),
    _parkour("swimming", "fish", 16),
    _parkour("climbing", "climbing_chimpanzee", 32),
)
"""The Parkour experiment of appendix C in the medium space: 48 different seeds, 16 per body, for 48 different
random initial Gaussians."""

MATRICES: tuple[Matrix, ...] = (ORIGINAL_SPACE, *STUMP_TRACKS_CHALLENGES, *PARKOUR)
"""Matrices of the full benchmark."""


def _case(study: str, challenge: str, *teachers: str) -> Matrix:
    """Return a case study's matrix for `teachers`; it shares its runs with the full benchmark."""
    return Matrix(f"{study}_{challenge}", "stump_tracks", challenge, teachers=teachers)


CASE_STUDIES: tuple[Matrix, ...] = (
    Matrix(
        "climbing",
        "parkour",
        "easy_dry",
        embodiments=("climbing_chimpanzee",),
        levels=(KnowledgeLevel.LOW,),
        seeds=tuple(range(16)),
        teachers=("random",),
        steps=10_000_000,
    ),
    _case("expert_knowledge", "mostly_unfeasible", "alp_gmm"),
    _case("expert_knowledge", "forgetting_student", "alp_gmm"),
    _case("needs_of_adr", "mostly_unfeasible", "adr"),
    _case("needs_of_adr", "mostly_trivial", "adr"),
    _case("needs_of_adr", "rugged_difficulty", "adr", "random"),
    _case("recovery", "forgetting_student", "goal_gan", "spdl", "alp_gmm", "adr"),
)
"""Case studies of the paper's appendix D: climbing in an easy space, expert knowledge for ALP-GMM,
requirements of ADR, and recovery from forgetting. All but the first share runs with the benchmark."""

OWN_KNOWLEDGE = {
    teacher: KnowledgeLevel.HIGH
    if teacher in ("adr", "goal_gan", "spdl", "setter_solver")
    else KnowledgeLevel.NONE
    for teacher in TEACHER_GRIDS
}
"""Knowledge level of each teacher in its authors' paper."""

TEACHER_SEARCH: tuple[Matrix, ...] = tuple(
    Matrix(
        f"search_{teacher}",
        "stump_tracks",
        "original",
        levels=(OWN_KNOWLEDGE[teacher],),
        seeds=tuple(range(16)),
        teachers=(teacher,),
        steps=7_000_000,
        teacher_grid=grid,
    )
    for teacher, grid in TEACHER_GRIDS.items()
)
"""Hyper-parameter searches of the teachers (appendix on hyper-parameters)."""

PPO_SEARCH = Matrix(
    "search_ppo",
    "stump_tracks",
    "original",
    students=("ppo",),
    levels=(KnowledgeLevel.NONE,),
    seeds=tuple(range(16)),
    teachers=("random",),
    steps=10_000_000,
    student_grid=PPO_GRID,
)
"""Hyper-parameter search of PPO, before those of teachers. Teacher and seeds are not in the paper."""


def select(matrices: Sequence[Matrix], challenges: Sequence[str]) -> tuple[Matrix, ...]:
    """Return the matrices with any of these names or challenges; an unknown one raises a ValueError."""
    names = {name for matrix in matrices for name in (matrix.name, matrix.challenge)}
    for name in challenges:
        if name not in names:
            listed = ", ".join(dict.fromkeys(matrix.name for matrix in matrices))
            raise ValueError(
                f"no challenge {name!r} in this experiment: {nearest(name, names)}known: {listed}"
            )
    return tuple(m for m in matrices if m.name in challenges or m.challenge in challenges)
