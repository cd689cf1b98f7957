"""Variants of the benchmark's challenges: other bodies, students, test tasks or settings than the paper's."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import pandas as pd

from tma_ray.benchmark import MATRICES, challenges_of
from tma_ray.part_names import base_name, split_name
from tma_ray.results import BOX2D, BOX2D_TEST_SET, CHIPMUNK, SIMULATED

PLUS = " + "

BIPEDAL, RELEASED_BIPEDAL = "classic_bipedal", "old_classic_bipedal"
"""The bipedal of the paper, and the body that the original release ran in its place."""

USUAL_STUDENT = "sac"
"""The student of challenges that the benchmark does not have."""


def parts_of(pool: str) -> list[tuple[str, str]]:
    """Returns body and student of each part of a pool, as its label names them."""
    return [(body, student) for body, _, student in (part.rpartition("/") for part in pool.split(PLUS))]


def shipped_together(environments: Iterable[str]) -> dict[tuple[str, str, str], tuple[str, ...]]:
    """Returns by engine, environment and challenge the test sets that count as one, one per type of body."""
    return {
        (engine, environment, name): tuple(
            sorted(f"{before}{each}" for each in {challenge.test_set, *challenge.other_test_sets.values()})
        )
        for engine, before in ((CHIPMUNK, ""), (BOX2D, BOX2D_TEST_SET))
        for environment in environments
        for name, challenge in challenges_of(environment).items()
    }


def variants(rows: pd.DataFrame) -> list[str]:
    """Returns how the pool of each row differs from the paper's, in words; empty where it does not.

    Results of one variant have one pool a challenge, so that aggregates over challenges count each once.

    Args:
        rows: with engine, environment, challenge, pool and test_sets, as in `pooling.pool_runs`.
    """
    columns = ["engine", "environment", "challenge", "pool", "test_sets"]
    return [_variant(*key) for key in rows[columns].itertuples(index=False, name=None)]


@cache
def _variant(engine: str, environment: str, challenge: str, pool: str, test_sets: object) -> str:
    place = base_name(environment), base_name(challenge)
    settings = split_name(environment)[1] | split_name(challenge)[1]
    bodies = {BIPEDAL if engine == BOX2D and body == RELEASED_BIPEDAL else body for body, _ in parts_of(pool)}
    students = {student for _, student in parts_of(pool)}
    alike = [matrix for matrix in MATRICES if (matrix.environment, matrix.challenge) == place]
    words = [f"{key}={value}" for key, value in settings.items()]
    if engine == SIMULATED:  # whose body, student and test tasks are all of its own
        return "; ".join([*words, "simulated students"])
    if bodies != {body for matrix in alike for body in matrix.embodiments} and alike:
        words.append(", ".join(sorted(bodies)))
    if students != ({student for matrix in alike for student in matrix.students} or {USUAL_STUDENT}):
        words.append(", ".join(sorted(students)))
    shipped = shipped_together([place[0]]).get((engine, *place), ())
    if alike and isinstance(test_sets, str) and test_sets != PLUS.join(shipped):
        words.append(f"test set {test_sets}")
    return "; ".join(words)
