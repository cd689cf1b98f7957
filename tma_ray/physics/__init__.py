"""Engines that simulate a body in a world with Chipmunk; creating the first imports numba and pymunk."""

from tma_ray.physics.base import PHYSICS_VERSION, TIME_STEP, Engine, SolverSettings
from tma_ray.physics.rules import (
    LIDAR_RANGE,
    LIDARS,
    Rules,
    Signal,
    action_signals,
    observation_signals,
    observation_size,
    step_arrays,
)
from tma_ray.physics.selection import EngineChoice, engine_in_use, make_engine

__all__ = [
    "LIDARS",
    "LIDAR_RANGE",
    "PHYSICS_VERSION",
    "TIME_STEP",
    "Engine",
    "EngineChoice",
    "Rules",
    "Signal",
    "SolverSettings",
    "action_signals",
    "engine_in_use",
    "make_engine",
    "observation_signals",
    "observation_size",
    "step_arrays",
]
