"""The benchmark as data: challenges, task spaces, test sets."""

from tma_ray.benchmark.challenges import (
    CHALLENGES,
    Challenge,
    challenges_of,
    find_challenge,
    load_test_set,
    shipped_test_sets,
)

__all__ = [
    "CHALLENGES",
    "Challenge",
    "challenges_of",
    "find_challenge",
    "load_test_set",
    "shipped_test_sets",
]
