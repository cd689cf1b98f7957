"""Worlds as arrays, built from a task and a random generator."""

from tma_ray.terrain.stump_tracks import stump_tracks
from tma_ray.terrain.terrain import GROUND_HEIGHT, Terrain

__all__ = ["GROUND_HEIGHT", "Terrain", "stump_tracks"]
