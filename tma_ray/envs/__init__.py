"""Gymnasium environments with procedurally generated worlds; members are imported on first access."""

from typing import TYPE_CHECKING

from tma_ray.support.lazy_imports import attach

if TYPE_CHECKING:
    from tma_ray.envs.catalogue import ENVIRONMENTS
    from tma_ray.envs.registration import (
        Environment,
        box_spaces,
        make_environment,
        mastery_return,
        register_environments,
    )
    from tma_ray.envs.scene import RenderOptions
    from tma_ray.envs.vector import VectorEnvironment, make_vector_environment
    from tma_ray.physics import Signal

__all__ = [
    "ENVIRONMENTS",
    "Environment",
    "RenderOptions",
    "Signal",
    "VectorEnvironment",
    "box_spaces",
    "make_environment",
    "make_vector_environment",
    "mastery_return",
    "register_environments",
]

__getattr__, __dir__ = attach(__name__, __file__)
