"""Environments with procedurally generated worlds, as Gymnasium environments."""

from tma_ray.envs.registration import (
    ENVIRONMENTS,
    Environment,
    make_environment,
    mastery_return,
    register_environments,
)

__all__ = ["ENVIRONMENTS", "Environment", "make_environment", "mastery_return", "register_environments"]
