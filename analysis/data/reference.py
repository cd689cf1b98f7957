"""The baseline teacher, Random, that all others are compared with."""

from __future__ import annotations

BASELINE = "random"
"""The teacher that all others are tested against (paper, section 5)."""

NO_BASELINE = "no Random to compare with"
"""Why a teacher was not tested, when that is it."""


def is_baseline(teacher: str) -> bool:
    """Tells whether `teacher` is the Random baseline."""
    return teacher.lower() == BASELINE
