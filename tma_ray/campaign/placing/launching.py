"""Launching of actors: the node, and the resources that they occupy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import ray
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy, NodeLabelSchedulingStrategy, NotIn

from tma_ray.campaign.settings import GIB, Resources

NODE_LABEL = "ray.io/node-id"
"""Label that Ray gives every node."""


def node_strategy(node: str, avoid: Sequence[str] = ()) -> Any:
    """Returns how Ray chooses the node of an actor.

    Args:
        node: Ray's id of the only one that will do; empty: any.
        avoid: nodes that are taken only if the others are full.
    """
    if node:
        return NodeAffinitySchedulingStrategy(node, soft=False)
    others: Any = NotIn
    return NodeLabelSchedulingStrategy({}, soft={NODE_LABEL: others(*avoid)}) if avoid else "DEFAULT"


def launcher(kind: type, resources: Resources, strategy: Any, concurrent_calls: int) -> Any:
    """Returns what makes an actor of class `kind` by ``remote``; Ray does not restart it.

    Args:
        kind: class of the actor.
        resources: that it occupies.
        strategy: of `node_strategy`.
        concurrent_calls: most calls that it answers at once.
    """
    remote: Any = ray.remote(kind)
    return remote.options(
        num_cpus=resources.cpus,
        num_gpus=resources.gpus,
        memory=int(resources.memory_gib * GIB),
        max_restarts=0,
        max_concurrency=concurrent_calls,
        scheduling_strategy=strategy,
    )
