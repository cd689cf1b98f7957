"""The experiments that have a script, the tiers of their size, and the stages of releases."""

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
    """Sizes of an experiment, in rising order."""

    SMOKE = "smoke"
    """Some minutes, most of them to start processes: does all of it work here?"""
    LITE = "lite"
    """A night on a laptop, with PPO: where is my teacher strong, roughly?"""
    PAPER = "paper"
    """Everything, as the paper has it."""


@dataclass(frozen=True)
class Size:
    """Changes of a tier to every experiment; None leaves the experiment's own value.

    Attributes:
        students: students that learn instead of the experiment's, where these are not what it searches.
        teachers: teachers where neither the experiment nor the user names any.
        levels: number of levels of expert knowledge that are kept, from the highest down.
        seeds: number of seeds that are kept of each combination.
        points: number of points that are kept of a grid of hyper-parameters.
        steps: budget of a run by environment, in environment steps; the experiment's own elsewhere.
        excluded_bodies: reason, in a sentence, for each body that is left out.
        evaluation_interval: between evaluations, in environment steps.
        probe_interval: between probes of the curriculum, in environment steps.
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
        """Return `matrix` reduced to this size; without bodies if all of them are excluded."""
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
            "climbing_chimpanzee": "Climbers are left out of this tier: in Parkour they master nothing, not "
            "even at the paper's budget."
        },
        evaluation_interval=250_000,
        probe_interval=100_000,
        training_window=100_000,
    ),
    Tier.PAPER: Size(),
}
"""PPO makes seventy times as many steps a second as SAC, which the paper uses nearly everywhere. Under it
teachers differ from 1 million steps on in Stump Tracks, and from 4 million in Parkour."""


LITE_TEACHERS = ("random", *sorted(TEACHER_GRIDS), "goal_gan:preset=release", "spdl:preset=release")
"""The paper's teachers, and two of them with the values of the original release's launch files, which differ
from the paper's table in what decides whether they learn."""

LITE_STEPS = 2_000_000  # budget of a release's runs, in environment steps: a tenth of the paper's

SCALED_TEACHERS = ("plr", "robust_plr", "accel", "sfl", "doraemon")
"""Teachers that came after the paper, with buffers, waits and intervals that can follow the budget."""

OTHER_LATER_TEACHERS = ("currot", "sobol", f"ramp:steps={LITE_STEPS // 2}")
"""One more that came after the paper, and two references; the ramp takes half the budget, as by default it
does of the paper's."""

LATER_CHALLENGES = ("original", "mostly_unfeasible", "rugged_difficulty")
"""Where later teachers were run first, and where settings for a budget are compared with their authors'."""


def _lite(matrix: Matrix, seeds: int, *levels: KnowledgeLevel) -> Matrix:
    """Return `matrix` for PPO and 2 million steps, with its first seeds and some of its levels."""
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
"""Intervals of its runs and of those of long-1, in environment steps."""

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
"""In the order in which they are run. The core offers every teacher all knowledge, so that each runs at the
highest level that it distinguishes: 7 combinations of challenge and body, 70 cells with 10 teachers. The
teachers of today have 24 cells with 3 seeds. The other levels come with 3 seeds, Parkour with 3 of each body,
and last the core gets its seeds 5 to 9."""

LITE_2_SIZE = Size(evaluation_interval=125_000, probe_interval=250_000, training_window=100_000)
"""Intervals of its runs, in environment steps: twice the evaluations of `LITE_1_SIZE`."""


def _decisive(matrices: Sequence[Matrix], *teachers: str) -> tuple[Matrix, ...]:
    """Return `matrices` for the student that the pilot chose, evaluated on every second task."""
    student = ("ppo:preset=decisive",)
    return tuple(replace(each, students=student, test_every=2, teachers=teachers) for each in matrices)


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
"""In the order in which they are run. Student and evaluations are those that a pilot chose
(``docs/pilot.md``). Core and later teachers have 126 cells with 5 seeds on the 7 combinations of challenge
and body; the later ones fit their settings to the budget, and with those of their authors they follow on 3
challenges with 3 seeds. Three teachers have the other levels and Parkour, with 3 seeds. Last come the seeds 5
to 9."""


LONG_STEPS = PAPER_STEPS

LONG_TEACHERS = (
    *("random", "adr", "alp_gmm", "covar_gmm", "riac", "goal_gan:preset=release", "spdl:preset=release"),
    *("setter_solver", "perm", "accel"),
)
"""The paper's teachers, two with the original release's values, and two that came after it, whose default
budget is that of these runs."""


def _long(matrix: Matrix, seeds: int, *teachers: str) -> Matrix:
    """Return `matrix` at the paper's budget, with its first seeds and its highest level of knowledge."""
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
        *(_long(matrix, 3) for matrix in (_WALKING, _SWIMMING)),
        _long(_CLIMBING, 2, "random", "alp_gmm"),
    ),
    "stump_tracks": tuple(_long(matrix, 3) for matrix in _SPACES),
    "more_seeds": tuple(_long(matrix, 5) for matrix in (_WALKING, _SWIMMING, *_SPACES)),
}
"""In the order in which they are run; ``docs/long_runs.md`` fixed them before their first run. The last has
two more seeds than the others, whose runs it shares."""


TEACHERS = ("random", *sorted(TEACHER_GRIDS))
"""The teachers that the paper compares."""


@dataclass(frozen=True)
class Experiment:
    """Runs of one script.

    Attributes:
        name: name of the experiment, its script and its campaign.
        title: subject, in a few words.
        matrices: combinations that are run.
        teachers: teachers of matrices that leave them open; empty where the user must name some.
        read_at: share of the budget after which its tables are read.
        searches: True if its result is the best point of each grid, not a ranking of teachers.
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
        """Return its size at `tier`; the largest is all of it."""
        return self.size if tier is Tier.PAPER else SIZES[tier]

    def stage(self, name: str | None) -> tuple[Matrix, ...]:
        """Return the matrices of a stage, all for None.

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
"""Sample efficiency is read from the runs of the challenges: where those are done, it runs nothing."""


def find_experiment(name: str) -> Experiment:
    """Return the experiment called `name`.

    Raises:
        ValueError: there is none; the message holds the nearest match.
    """
    known = {experiment.name: experiment for experiment in EXPERIMENTS}
    check_known("experiment", name, known, "known:")
    return known[name]
