"""Worlds as arrays. Each kind has a module that builds them from a task and a random generator."""

from tma_ray.terrain.base import CEILING, FIXED, GROUND_HEIGHT, Terrain

__all__ = ["CEILING", "FIXED", "GROUND_HEIGHT", "Terrain"]
