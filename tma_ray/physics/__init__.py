"""Engines: a body in a world, simulated by Chipmunk."""

from tma_ray.physics.arrays import LIDAR_RANGE, LIDARS, observation_size
from tma_ray.physics.engine import PHYSICS_VERSION, TIME_STEP, Engine, SolverSettings
from tma_ray.physics.pymunk_engine import PymunkEngine

__all__ = [
    "LIDARS",
    "LIDAR_RANGE",
    "PHYSICS_VERSION",
    "TIME_STEP",
    "Engine",
    "PymunkEngine",
    "SolverSettings",
    "observation_size",
]
