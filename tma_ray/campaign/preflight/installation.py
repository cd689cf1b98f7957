"""A check that the workers of every node find tma_ray, in the driver's version, before anything else."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import version
from typing import Any

import ray
from ray.exceptions import RayError, RayTaskError
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from tma_ray.campaign.cluster.connection import working_nodes


def check_installation() -> None:
    """Refuses a cluster some of whose nodes have another tma_ray, or none.

    Ray's processes run in the environment in which Ray was started there, also on the driver's own node.

    Raises:
        ConnectionError: which node, and what it has.
    """
    here = version("tma_ray")
    task: Any = ray.remote(num_cpus=0, max_retries=0)(_finder())
    asked = {}
    for node in working_nodes():
        there = NodeAffinitySchedulingStrategy(node["NodeID"], soft=True)
        asked[task.options(scheduling_strategy=there).remote()] = node["NodeManagerAddress"]
    for answer, address in asked.items():
        try:
            found = ray.get(answer)
        except RayError as error:
            cause = error.cause if isinstance(error, RayTaskError) else error
            found = f"none that can be imported ({cause})"
        if found != here:
            raise ConnectionError(
                f"the Ray node {address} has another tma_ray than this process: {found}, not {here}. "
                f"Install tma_ray {here} in the environment in which 'ray start' is called on that node, and "
                f"start Ray there again"
            )


def _finder() -> Callable[[], str]:
    """Returns a function that Ray sends whole: one of this module would need tma_ray to be found at all."""

    def installed() -> str:
        from importlib.metadata import version

        import tma_ray  # noqa: F401

        return version("tma_ray")

    return installed
