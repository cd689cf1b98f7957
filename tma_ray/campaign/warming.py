"""Compiling on every node before its first run, so that actors do not all compile at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import ray
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from tma_ray.campaign.cluster import living_nodes
from tma_ray.envs import make_environment
from tma_ray.runs.spec import RunSpec


def warm_nodes(specs: Sequence[RunSpec]) -> None:
    """Makes every environment of `specs` once on each other node; the driver's own has done so in planning.

    What is compiled on the way stays in the nodes' caches. Nodes that join later compile when they
    start their first run.
    """
    here = ray.get_runtime_context().get_node_id()
    others = [node["NodeID"] for node in living_nodes() if node["NodeID"] != here]
    recipes = {(spec.environment, tuple(spec.environment_options.items())) for spec in specs}
    task: Any = ray.remote(_make)
    started = [
        task.options(num_cpus=0, scheduling_strategy=NodeAffinitySchedulingStrategy(node, soft=True)).remote(
            name, dict(options)
        )
        for node in others
        for name, options in recipes
    ]
    ray.get(started)


def _make(name: str, options: dict[str, Any]) -> None:
    environment = make_environment(name, **options)
    environment.reset(seed=0, options={"task": environment.get_wrapper_attr("task_space").low})
    environment.close()
