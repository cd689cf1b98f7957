"""Names under which gymnasium and the command line find the environments."""

from __future__ import annotations

from typing import Any

import gymnasium

from tma_ray.registry import Registry
from tma_ray.tasks import TaskSpace

Environment = gymnasium.Env[Any, Any]
"""Any Gymnasium environment with the attributes `task_space` and `valid_domain` (TaskSpace) whose `reset`
takes ``options={"task": …}`` and whose `info` reports "success"."""

ENVIRONMENTS: Registry[type[Environment]] = Registry(
    "environment", "tma_ray.environments", {"stump_tracks": "tma_ray.envs.stump_tracks:StumpTracks"}
)
"""Environments by name; more through `ENVIRONMENTS.register`, an entry point, or ``module:Name``."""

GYMNASIUM_IDS = {"tma_ray/StumpTracks-v0": "tma_ray.envs.stump_tracks:StumpTracks"}
"""What `gymnasium.make` knows. The environments truncate their episodes themselves."""


def register_environments() -> None:
    """Registers the environments with gymnasium; importing tma_ray does it."""
    for name, target in GYMNASIUM_IDS.items():
        if name not in gymnasium.registry:
            gymnasium.register(id=name, entry_point=target)


def make_environment(name: str, **kwargs: Any) -> Environment:
    """Returns a new environment.

    Args:
        name: a name in ENVIRONMENTS, or ``module:Name``.
        kwargs: for its constructor, such as `embodiment` and `render_mode`.

    Raises:
        UnknownNameError: nothing answers to `name`.
        TypeError: it has no task space, so that no teacher could work with it.
    """
    environment = ENVIRONMENTS.get(name)(**kwargs)
    for attribute in ("task_space", "valid_domain"):
        if not isinstance(getattr(environment, attribute, None), TaskSpace):
            raise TypeError(f"environment {name!r} must have an attribute {attribute} of type TaskSpace")
    return environment
