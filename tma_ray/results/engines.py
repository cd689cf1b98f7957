"""The simulator behind a run's worlds: results of different engines are never pooled or tested together."""

from __future__ import annotations

from typing import Final

CHIPMUNK: Final = "Chipmunk"
"""Simulates the worlds of tma_ray; a run whose spec names no engine is one of its."""

BOX2D: Final = "Box2D"
"""Simulated the worlds of the original release."""

SIMULATED: Final = "Simulated students"
"""Stands for the equations of students without physics."""

NO_PHYSICS_VERSION: Final = 0
"""Physics version of runs of other engines; those of tma_ray count from 1."""

BOX2D_TEST_SET: Final = "box2d_"
"""Before the name of a test set whose worlds were Box2D's."""
