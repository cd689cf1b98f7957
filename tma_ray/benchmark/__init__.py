"""The benchmark as data: challenges, task spaces, test sets."""

from tma_ray.benchmark.challenges import (
    CHALLENGES,
    Challenge,
    challenges_of,
    find_challenge,
    load_test_set,
    shipped_test_sets,
)
from tma_ray.benchmark.matrices import MATRICES, ORIGINAL_SPACE, PARKOUR, STUMP_TRACKS_CHALLENGES, Matrix

__all__ = [
    "CHALLENGES",
    "MATRICES",
    "ORIGINAL_SPACE",
    "PARKOUR",
    "STUMP_TRACKS_CHALLENGES",
    "Challenge",
    "Matrix",
    "challenges_of",
    "find_challenge",
    "load_test_set",
    "shipped_test_sets",
]
