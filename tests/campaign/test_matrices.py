"""The paper's numbers of runs, and how many are executed once cells share them."""

from __future__ import annotations

from collections.abc import Iterable

import pytest

from tma_ray.benchmark import MATRICES, ORIGINAL_SPACE, PARKOUR, STUMP_TRACKS_CHALLENGES, Matrix
from tma_ray.campaign import matrix_campaigns, matrix_cells
from tma_ray.runs import Schedule

FROM_LOW_KNOWLEDGE = ("adr", "goal_gan", "setter_solver")

PAPERS = ("random", "riac", "alp_gmm", "covar_gmm", "spdl", *FROM_LOW_KNOWLEDGE)
"""Other tests may have registered more."""


def counts(matrices: Iterable[Matrix], teacher: str) -> tuple[int, int]:
    """Run as the paper counts them, and those that are executed."""
    plans = [campaign.plan() for campaign in matrix_campaigns(matrices, (teacher,))]
    run_ids = {spec.run_id for plan in plans for spec in plan.runs}
    return sum(len(plan.cell_rows) for plan in plans), len(run_ids)


@pytest.mark.parametrize("teacher", PAPERS)
def test_cells_are_the_papers(teacher: str) -> None:
    """Appendix C: 15 experiments of 32 seeds, diverse students in four parts; 10 without a level too low."""
    levels = 2 if teacher in FROM_LOW_KNOWLEDGE else 3
    sizes = [len(matrix_cells(matrix, (teacher,))) for matrix in STUMP_TRACKS_CHALLENGES]
    assert sizes == [levels, levels, levels, levels, 4 * levels]
    assert len(matrix_cells(ORIGINAL_SPACE, (teacher,))) == levels
    assert [len(matrix_cells(matrix, (teacher,))) for matrix in PARKOUR] == [1, 1, 1]


@pytest.mark.parametrize(
    ("teacher", "challenges", "original"),
    [
        ("random", (768, 256), (96, 32)),
        ("riac", (768, 256), (96, 32)),
        ("alp_gmm", (768, 512), (96, 64)),
        ("spdl", (768, 512), (96, 64)),
        ("adr", (512, 512), (64, 64)),
        ("setter_solver", (512, 256), (64, 32)),
    ],
)
def test_levels_that_make_no_difference_are_executed_once(
    teacher: str, challenges: tuple[int, int], original: tuple[int, int]
) -> None:
    assert counts(STUMP_TRACKS_CHALLENGES, teacher) == challenges
    assert counts([ORIGINAL_SPACE], teacher) == original
    assert counts(PARKOUR, teacher) == (48, 48)


def test_all_teachers_together() -> None:
    """Five that run everywhere and three that need low knowledge."""
    cells = {matrix.name: len(matrix_cells(matrix, PAPERS)) * len(matrix.seeds) for matrix in MATRICES}
    assert sum(cells[matrix.name] for matrix in STUMP_TRACKS_CHALLENGES) == 5 * 768 + 3 * 512
    assert sum(cells[matrix.name] for matrix in PARKOUR) == 8 * 48
    assert cells[ORIGINAL_SPACE.name] == 5 * 96 + 3 * 64


def test_parkours_bodies_share_no_seed() -> None:
    assert sorted(seed for matrix in PARKOUR for seed in matrix.seeds) == list(range(48))
    assert [matrix.embodiments for matrix in PARKOUR] == [
        ("classic_bipedal",),
        ("fish",),
        ("climbing_chimpanzee",),
    ]


def test_a_matrix_becomes_a_campaign_with_its_seeds_and_any_budget() -> None:
    first, *_ = matrix_campaigns(PARKOUR, ("random",), Schedule(steps=1_000))
    assert (first.name, first.seeds, first.schedule.steps) == ("parkour_walking", tuple(range(16)), 1_000)
    assert matrix_campaigns([ORIGINAL_SPACE], ("random",))[0].schedule == Schedule()
