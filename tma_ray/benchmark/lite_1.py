"""The runs of the release ``lite-1``: PPO, 2 million steps, in stages of falling importance."""

from __future__ import annotations

from dataclasses import replace

from tma_ray.benchmark.grids import TEACHER_GRIDS
from tma_ray.benchmark.matrices import ORIGINAL_SPACE, PARKOUR, STUMP_TRACKS_CHALLENGES, Matrix
from tma_ray.benchmark.tiers import Size
from tma_ray.tasks import KnowledgeLevel

LITE_1_TEACHERS = ("random", *sorted(TEACHER_GRIDS), "goal_gan:preset=release", "spdl:preset=release")
"""The paper's teachers, and two of them with the values of the original release's launch files, which differ
from the paper's table in what decides whether they learn."""

LITE_1_STEPS = 2_000_000
"""Budget of its runs, in environment steps: a tenth of the paper's."""

TEACHERS_OF_TODAY = (
    "plr",
    "robust_plr",
    "accel",
    "sfl",
    "currot",
    "doraemon",
    "sobol",
    f"ramp:steps={LITE_1_STEPS // 2}",
)
"""Teachers that came after the paper, and two references; the ramp takes half the budget, as by default it
does of the paper's."""

LITE_1_SIZE = Size(evaluation_interval=250_000, probe_interval=250_000, training_window=100_000)
"""Intervals of its runs, in environment steps."""


def _lite(matrix: Matrix, seeds: int, *levels: KnowledgeLevel) -> Matrix:
    """Returns `matrix` for PPO and 2 million steps, with its first seeds and some of its levels."""
    return replace(
        matrix,
        students=("ppo",),
        levels=levels or matrix.levels,
        seeds=matrix.seeds[:seeds],
        steps=LITE_1_STEPS,
    )


def _stump_tracks(seeds: int, *levels: KnowledgeLevel) -> tuple[Matrix, ...]:
    return tuple(_lite(matrix, seeds, *levels) for matrix in (ORIGINAL_SPACE, *STUMP_TRACKS_CHALLENGES))


def _today(seeds: int) -> tuple[Matrix, ...]:
    """Returns the teachers of today on the original space, an unfeasible one and a rugged one."""
    names = ("original", "mostly_unfeasible", "rugged_difficulty")
    return tuple(
        replace(matrix, teachers=TEACHERS_OF_TODAY)
        for matrix in _stump_tracks(seeds, KnowledgeLevel.HIGH)
        if matrix.name in names
    )


LITE_1_STAGES: dict[str, tuple[Matrix, ...]] = {
    "core": _stump_tracks(5, KnowledgeLevel.HIGH),
    "today": _today(3),
    "levels": _stump_tracks(3, KnowledgeLevel.NONE, KnowledgeLevel.LOW),
    "parkour": tuple(_lite(matrix, 3) for matrix in PARKOUR),
    "seeds": _stump_tracks(10, KnowledgeLevel.HIGH),
}
"""In the order in which they are run. The core offers every teacher all knowledge, so that each runs at the
highest level that it distinguishes: 7 combinations of challenge and body, 70 cells with 10 teachers. The
teachers of today have 24 cells with 3 seeds. The other levels come with 3 seeds, Parkour with 3 of each body,
and last the core gets its seeds 5 to 9."""
