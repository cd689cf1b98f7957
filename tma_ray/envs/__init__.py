"""Environments with procedurally generated worlds, as Gymnasium environments."""

from tma_ray.envs.drawing.look import Look
from tma_ray.envs.registration import (
    ENVIRONMENTS,
    Environment,
    make_environment,
    mastery_return,
    register_environments,
)
from tma_ray.physics import Signal

__all__ = [
    "ENVIRONMENTS",
    "Environment",
    "Look",
    "Signal",
    "make_environment",
    "mastery_return",
    "register_environments",
]
