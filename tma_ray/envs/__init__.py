"""Environments with procedurally generated worlds, as Gymnasium environments."""

from tma_ray.envs.registration import ENVIRONMENTS, Environment, make_environment, register_environments

__all__ = ["ENVIRONMENTS", "Environment", "make_environment", "register_environments"]
