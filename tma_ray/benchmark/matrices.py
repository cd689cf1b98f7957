"""Experiment matrices of the paper, and the grids of its hyper-parameter searches."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from tma_ray.benchmark.challenges import find_challenge
from tma_ray.support.component_names import nearest
from tma_ray.tasks import KnowledgeLevel


@dataclass(frozen=True)
class Grid:
    """Grid of hyper-parameters.

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


_OF_MIXTURES = {
    "fit_every": (50, 150, 250, 350),
    "most_components": (5, 10, 15, 20),
    "explore": (0.05, 0.1, 0.2, 0.3),
}

TEACHER_GRIDS: Mapping[str, Grid] = {
    "adr": Grid(
        {
            "shrink_at": (0.0, 50.0),
            "expand_at": (180.0, 230.0, 280.0),
            "boundary_share": (0.3, 0.5, 0.7),
            "queue_size": (10, 20),
            "step": (0.05, 0.1),
        },
        chosen={"shrink_at": 0.0, "expand_at": 180.0, "boundary_share": 0.7, "queue_size": 10, "step": 0.1},
    ),
    "riac": Grid(
        {
            "region_capacity": (50, 150, 250, 350),
            "split_attempts": (25, 50, 75, 100),
            "smallest_side": (0.0677, 0.1, 0.1677, 0.2),
        },
        chosen={"region_capacity": 150, "split_attempts": 75, "smallest_side": 0.1},
    ),
    "covar_gmm": Grid(
        _OF_MIXTURES,
        chosen={"fit_every": 150, "most_components": 15, "explore": 0.1},
    ),
    "alp_gmm": Grid(
        _OF_MIXTURES,
        chosen={"fit_every": 150, "most_components": 10, "explore": 0.05},
    ),
    "goal_gan": Grid(
        {
            "noise": (0.01, 0.05, 0.1),
            "train_every": (100, 200, 300),
            "old_share": (0.1, 0.2, 0.3),
            "rollouts": (2, 5, 10),
        },
        chosen={"noise": 0.01, "train_every": 100, "old_share": 0.2, "rollouts": 2},
    ),
    "spdl": Grid(
        {
            "first_update": (100_000, 200_000),
            "update_every": (50_000, 100_000),
            "updates_without_penalty": (0, 5, 10),
            "penalty_share": (0.05, 0.25, 0.5),
            "most_divergence": (0.1, 0.8),
        },
        chosen={
            "first_update": 200_000,
            "update_every": 100_000,
            "updates_without_penalty": 0,
            "penalty_share": 0.05,
            "most_divergence": 0.8,
        },
    ),
    "setter_solver": Grid(
        {
            "update_every": (50, 100, 200, 300),
            "noise": (0.005, 0.01, 0.05, 0.1),
            "hidden_units": (64, 128, 256, 512),
        },
        chosen={"update_every": 100, "noise": 0.05, "hidden_units": 128},
    ),
}
"""Searched grid of each teacher (paper, appendix on hyper-parameters): 64 to 81 combinations."""

PPO_GRID = Grid(
    {
        "steps_per_update": (1_000, 2_000, 4_000),
        "epochs": (5, 10),
        "learning_rate": (1e-4, 3e-4, 1e-3),
        "batch_size": (500, 1_000),
        "value_coefficient": (0.5, 1.0),
        "entropy_coefficient": (0.0, 0.01),
    },
    chosen={
        "steps_per_update": 2_000,
        "epochs": 5,
        "learning_rate": 3e-4,
        "batch_size": 1_000,
        "value_coefficient": 0.5,
        "entropy_coefficient": 0.0,
    },
)
"""Searched grid of PPO. The paper names hyper-parameters and choice (appendix on students); the other values
are ours."""


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
    """Return a matrix of some teachers that shares its runs with the benchmark."""
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
