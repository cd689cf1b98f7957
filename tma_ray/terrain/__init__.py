"""Terrains as arrays, with one module per environment that builds them from a task."""

from tma_ray.terrain.terrain import CEILING, FIXED, GROUND_HEIGHT, Terrain

__all__ = ["CEILING", "FIXED", "GROUND_HEIGHT", "Terrain"]
