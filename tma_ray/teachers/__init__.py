"""Automatic curriculum learning algorithms, which depend only on `tma_ray.tasks`."""

from tma_ray.teachers.base import Teacher
from tma_ray.teachers.catalogue import (
    TEACHERS,
    canonical_teacher,
    check_limits,
    effective_level,
    hyperparameters_of,
    knows_enough,
    make_teacher,
    register_teacher,
)

__all__ = [
    "TEACHERS",
    "Teacher",
    "canonical_teacher",
    "check_limits",
    "effective_level",
    "hyperparameters_of",
    "knows_enough",
    "make_teacher",
    "register_teacher",
]
