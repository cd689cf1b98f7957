"""Environments with procedurally generated worlds, as Gymnasium environments."""

from tma_ray.envs.drawing.look import Look
from tma_ray.envs.registration import (
    ENVIRONMENTS,
    Environment,
    make_environment,
    mastery_return,
    register_environments,
)
from tma_ray.envs.vector import VectorEnvironment, make_vector_environment
from tma_ray.physics import Signal

__all__ = [
    "ENVIRONMENTS",
    "Environment",
    "Look",
    "Signal",
    "VectorEnvironment",
    "make_environment",
    "make_vector_environment",
    "mastery_return",
    "register_environments",
]
