"""A check that every node of the cluster can access the results root, before the first run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import ray
from ray.exceptions import RayError, RayTaskError
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from tma_ray.campaign.cluster.connection import working_nodes
from tma_ray.results import ObjectStoreError, ResultsRootError, Store


def check_storage_access(store: Store) -> None:
    """Refuses a root that some node cannot use: another machine's folder, a bucket without credentials.

    Raises:
        ResultsRootError: which node does not see the folder.
        ObjectStoreError: which node cannot use the bucket, and why: each has credentials of its own.
    """
    if store.is_object_store:
        _ask_nodes(store, working_nodes(), None)
    elif others := _other_nodes():
        probe = store.temporary()
        store.write_bytes(probe, b"seen")
        try:
            _ask_nodes(store, others, probe)
        finally:
            store.delete(probe)


def _other_nodes() -> list[dict[str, Any]]:
    here = ray.get_runtime_context().get_node_id()
    return [node for node in working_nodes() if node["NodeID"] != here]


def _ask_nodes(store: Store, nodes: Sequence[dict[str, Any]], probe: str | None) -> None:
    task: Any = ray.remote(num_cpus=0)(can_access)
    asked = {}
    for node in nodes:
        there = NodeAffinitySchedulingStrategy(node["NodeID"], soft=True)
        answer = task.options(scheduling_strategy=there).remote(store, probe)
        asked[answer] = f"the Ray node {node['NodeManagerAddress']}"
    for answer, name in asked.items():
        try:
            if not ray.get(answer):
                raise ResultsRootError(
                    f"{name} does not see this machine's {store}: choose a folder that all nodes mount, or "
                    f"s3:// or gs://"
                )
        except RayError as error:
            cause = error.cause if isinstance(error, RayTaskError) else error
            raise ObjectStoreError(
                f"{name} cannot use the root: {cause}; every node takes its credentials from its role or "
                f"from the environment in which Ray was started there"
            ) from error


def can_access(store: Store, probe: str | None) -> bool:
    """Tells whether this node sees the file `probe` of `store`, or may use the bucket if that is None."""
    if probe is not None:
        return store.exists(probe)
    store.check_access()
    return True
