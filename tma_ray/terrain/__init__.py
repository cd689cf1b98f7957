"""Terrains as arrays, built from tasks by one module per environment."""

from tma_ray.terrain.terrain import CEILING, FIXED, GROUND_HEIGHT, Terrain

__all__ = ["CEILING", "FIXED", "GROUND_HEIGHT", "Terrain"]
