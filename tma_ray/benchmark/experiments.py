"""Experiments of the benchmark, their tiers, and the stages of releases."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

from tma_ray.benchmark.matrices import (
    CASE_STUDIES,
    MATRICES,
    ORIGINAL_SPACE,
    PARKOUR,
    PPO_SEARCH,
    STUMP_TRACKS_CHALLENGES,
    TEACHER_GRIDS,
    TEACHER_SEARCH,
    Matrix,
    select,
)
from tma_ray.benchmark.paper import PAPER_STEPS
from tma_ray.support.validation import check_known
from tma_ray.tasks import KnowledgeLevel


class Tier(StrEnum):
    """Tiers of an experiment, in rising order of size."""

    SMOKE = "smoke"
    """Smoke test of a few minutes, mostly spent on starting processes."""
    LITE = "lite"
    """Rough comparison with PPO, overnight on a laptop."""
    PAPER = "paper"
    """The full experiment of the paper."""


@dataclass(frozen=True)
class Size:
    """Overrides that a tier applies to every experiment; None keeps the experiment's value.

    Attributes:
        students: students, unless the experiment searches their hyper-parameters.
        teachers: teachers, if neither the experiment nor the user names any.
        levels: number of knowledge levels, from the highest down.
        seeds: number of seeds per combination.
        points: number of points of a grid of hyper-parameters.
        steps: budget of a run by environment, in environment steps.
        excluded_bodies: reasons for excluding bodies, as sentences, by body.
        evaluation_interval: interval between evaluations, in environment steps.
        probe_interval: interval between probes of the curriculum, in environment steps.
        training_window: length of the windows of training statistics, in environment steps.
    """

    students: tuple[str, ...] | None = None
    teachers: tuple[str, ...] | None = None
    levels: int | None = None
    seeds: int | None = None
    points: int | None = None
    steps: Mapping[str, int] = field(default_factory=dict)
    excluded_bodies: Mapping[str, str] = field(default_factory=dict)
    evaluation_interval: int | None = None
    probe_interval: int | None = None
    training_window: int | None = None

    def of(self, matrix: Matrix) -> Matrix:
        """Return `matrix` reduced to this size, possibly with no bodies left."""
        return replace(
            matrix,
            embodiments=tuple(body for body in matrix.embodiments if body not in self.excluded_bodies),
            students=(not matrix.student_grid and self.students) or matrix.students,
            levels=matrix.levels[-(self.levels or len(matrix.levels)) :],
            seeds=matrix.seeds[: self.seeds],
            steps=self.steps.get(matrix.environment, matrix.steps),
            most_points=self.points or matrix.most_points,
        )


SIZES: dict[Tier, Size] = {
    Tier.SMOKE: Size(
        students=("ppo",),
        teachers=("random", "alp_gmm"),
        levels=1,
        seeds=1,
        points=2,
        steps={"stump_tracks": 4_000, "parkour": 4_000},
        evaluation_interval=4_000,
        probe_interval=2_000,
        training_window=1_000,
    ),
    Tier.LITE: Size(
        students=("ppo:preset=decisive",),
        seeds=3,
        points=12,
        steps={"stump_tracks": 2_000_000, "parkour": 6_000_000},
        excluded_bodies={
            "climbing_chimpanzee": "Climbers are left out of this tier: in Parkour they master few tasks "
            "within its budget."
        },
        evaluation_interval=250_000,
        probe_interval=100_000,
        training_window=100_000,
    ),
    Tier.PAPER: Size(),
}
"""PPO is seventy times as fast as the paper's SAC, and teachers differ from 1 million steps on in Stump
Tracks and from 4 million in Parkour."""


LITE_TEACHERS = ("random", *sorted(TEACHER_GRIDS), "goal_gan:preset=release", "spdl:preset=release")
"""The paper's teachers, and variants of two with values from the original release's launch files."""

LITE_STEPS = 2_000_000  # budget of a release's runs, a tenth of the paper's

SCALED_TEACHERS = ("plr", "robust_plr", "accel", "sfl", "doraemon")
"""Teachers published after the paper whose buffers, waits and intervals can be scaled to the budget."""

OTHER_LATER_TEACHERS = ("currot", "sobol", f"ramp:steps={LITE_STEPS // 2}")
"""One more teacher published after the paper, and two references; the ramp takes half the budget."""

LATER_CHALLENGES = ("original", "mostly_unfeasible", "rugged_difficulty")
"""Challenges for the first runs of later teachers, and for runs with their authors' settings."""


def _lite(matrix: Matrix, seeds: int, *levels: KnowledgeLevel) -> Matrix:
    """Return `matrix` reduced to PPO, 2 million steps, its first seeds and the given levels."""
    return replace(
        matrix,
        students=("ppo",),
        levels=levels or matrix.levels,
        seeds=matrix.seeds[:seeds],
        steps=LITE_STEPS,
    )


def _stump_tracks(seeds: int, *levels: KnowledgeLevel) -> tuple[Matrix, ...]:
    return tuple(_lite(matrix, seeds, *levels) for matrix in (ORIGINAL_SPACE, *STUMP_TRACKS_CHALLENGES))


LITE_1_SIZE = Size(evaluation_interval=250_000, probe_interval=250_000, training_window=100_000)
"""Intervals of runs of lite-1 and long-1, in environment steps."""

LITE_1_STAGES: dict[str, tuple[Matrix, ...]] = {
    "core": _stump_tracks(5, KnowledgeLevel.HIGH),
    "today": tuple(
        replace(matrix, teachers=SCALED_TEACHERS + OTHER_LATER_TEACHERS)
        for matrix in select(_stump_tracks(3, KnowledgeLevel.HIGH), LATER_CHALLENGES)
    ),
    "levels": _stump_tracks(3, KnowledgeLevel.NONE, KnowledgeLevel.LOW),
    "parkour": tuple(_lite(matrix, 3) for matrix in PARKOUR),
    "seeds": _stump_tracks(10, KnowledgeLevel.HIGH),
}
"""Stages in order of execution. The core has high knowledge on 7 combinations of challenge and body: 70 cells
with 10 teachers. Today's teachers have 24 cells with 3 seeds, the other levels and each body of Parkour 3
seeds. The last stage adds seeds 5 to 9 of the core."""

LITE_2_SIZE = Size(evaluation_interval=125_000, probe_interval=250_000, training_window=100_000)
"""Intervals of runs of lite-2, in environment steps: twice the evaluations of `LITE_1_SIZE`."""


def _decisive(matrices: Sequence[Matrix], *teachers: str) -> tuple[Matrix, ...]:
    """Return `matrices` for `teachers` and the pilot's student, evaluated on every second test task."""
    student = ("ppo:preset=decisive",)
    return tuple(replace(m, students=student, test_every=2, teachers=teachers) for m in matrices)


_LATER = (*(f"{teacher}:budget={LITE_STEPS}" for teacher in SCALED_TEACHERS), *OTHER_LATER_TEACHERS)
_FEW = ("random", "alp_gmm", "spdl")

LITE_2_STAGES: dict[str, tuple[Matrix, ...]] = {
    "core": _decisive(_stump_tracks(5, KnowledgeLevel.HIGH)),
    "later": _decisive(_stump_tracks(5, KnowledgeLevel.HIGH), *_LATER),
    "authors": _decisive(select(_stump_tracks(3, KnowledgeLevel.HIGH), LATER_CHALLENGES), *SCALED_TEACHERS),
    "levels": _decisive(_stump_tracks(3, KnowledgeLevel.NONE, KnowledgeLevel.LOW), *_FEW),
    "parkour": _decisive([_lite(matrix, 3) for matrix in PARKOUR], *_FEW),
    "seeds": _decisive(_stump_tracks(10, KnowledgeLevel.HIGH)),
    "later_seeds": _decisive(_stump_tracks(10, KnowledgeLevel.HIGH), *_LATER),
}
"""Stages in order of execution, with student and evaluations of a pilot (``docs/pilot.md``). Core and later
teachers have 126 cells with 5 seeds on the 7 combinations of challenge and body. Later teachers scale with
the budget, and run with their authors' settings on 3 challenges with 3 seeds. Three teachers have the other
levels and Parkour, with 3 seeds. The last stages add seeds 5 to 9."""


LONG_STEPS = PAPER_STEPS

LONG_TEACHERS = (
    *("random", "adr", "alp_gmm", "covar_gmm", "riac", "goal_gan:preset=release", "spdl:preset=release"),
    *("setter_solver", "perm", "accel"),
)
"""The paper's teachers, two with the original release's values, and two published later."""


def _long(matrix: Matrix, seeds: int, *teachers: str) -> Matrix:
    """Return `matrix` reduced to its first seeds and highest knowledge level, at the paper's budget.

    Without `teachers`, those in `LONG_TEACHERS` are used. Students and tests are those of `_decisive`.
    """
    return replace(
        matrix,
        students=("ppo:preset=decisive",),
        levels=matrix.levels[-1:],
        seeds=matrix.seeds[:seeds],
        teachers=teachers or LONG_TEACHERS,
        steps=LONG_STEPS,
        test_every=2,
    )


_WALKING, _SWIMMING, _CLIMBING = PARKOUR
_SPACES = ORIGINAL_SPACE, *select(MATRICES, ["mostly_unfeasible"])

LONG_1_STAGES: dict[str, tuple[Matrix, ...]] = {
    "parkour": (
        *(_long(matrix, 3) for matrix in (_SWIMMING, _WALKING)),
        _long(_CLIMBING, 2, "random", "alp_gmm"),
    ),
    "stump_tracks": tuple(_long(matrix, 3) for matrix in _SPACES),
    "more_seeds": tuple(_long(matrix, 5) for matrix in (_SWIMMING, _WALKING, *_SPACES)),
}
"""Stages in order of execution, fixed in ``docs/long_runs.md`` before the first run. The last one adds two
seeds. The fish comes first, since its runs differ most between teachers."""


TEACHERS = ("random", *sorted(TEACHER_GRIDS))  # the teachers compared in the paper


@dataclass(frozen=True)
class Experiment:
    """Experiment of the benchmark: matrices, teachers, stages and size.

    Attributes:
        name: name of the experiment, its script and its campaign.
        title: subject in a few words.
        matrices: matrices to run.
        teachers: teachers of matrices without any; empty if the user must name them.
        read_at: share of the budget after which its tables are read.
        searches: True if its result is the best point of each grid, not a ranking of teachers.
        stages: matrices by name of a stage.
        size: intervals of its runs, None in a field for the paper's.
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
        """Return the size of the experiment at `tier`; the largest tier uses the experiment's own."""
        return self.size if tier is Tier.PAPER else SIZES[tier]

    def stage(self, name: str | None) -> tuple[Matrix, ...]:
        """Return the matrices of a stage, or of all stages for None; an unknown stage raises a ValueError."""
        if name is None:
            return self.matrices
        if name not in self.stages:
            listed = ", ".join(self.stages) or "none"
            raise ValueError(f"{self.name} has no stage {name!r}; known: {listed}")
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
        LITE_TEACHERS,
        stages=LITE_1_STAGES,
        size=LITE_1_SIZE,
    ),
    Experiment(
        "lite_2",
        "The release lite-2: all teachers with the student under which they differ most",
        tuple(matrix for stage in LITE_2_STAGES.values() for matrix in stage),
        LITE_TEACHERS,
        stages=LITE_2_STAGES,
        size=LITE_2_SIZE,
    ),
    Experiment(
        "long_1",
        "The release long-1: ten teachers at the paper's budget, in Parkour and on Stump Tracks",
        tuple(matrix for stage in LONG_1_STAGES.values() for matrix in stage),
        LONG_TEACHERS,
        stages=LONG_1_STAGES,
        size=LITE_1_SIZE,
    ),
)
"""Experiments with a script. Sample efficiency shares all runs with the challenges."""


def find_experiment(name: str) -> Experiment:
    """Return the experiment called `name`, or raise a ValueError with the nearest match."""
    experiments = {experiment.name: experiment for experiment in EXPERIMENTS}
    check_known("experiment", name, experiments, "known:")
    return experiments[name]
