"""Registry of environments, importable without gymnasium."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tma_ray.components.registry import Registry

if TYPE_CHECKING:
    import gymnasium

ENVIRONMENTS: Registry[type[gymnasium.Env[Any, Any]]] = Registry(
    "environment",
    "tma_ray.environments",
    {"stump_tracks": "tma_ray.envs.stump_tracks:StumpTracks", "parkour": "tma_ray.envs.parkour:Parkour"},
    "gymnasium:Env",
)
"""Environments by name; plug-ins use `ENVIRONMENTS.register`, an entry point, or ``module:Name``."""
