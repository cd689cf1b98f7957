"""Nodes of a Ray cluster and their resources."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import psutil
import yaml
from ray.exceptions import RayError

from tma_ray.campaign.cluster.ray_private import head_address, living_nodes, resources_at
from tma_ray.campaign.settings import GIB, PLENTY, Nodes, Resources, connection_advice
from tma_ray.support.texts import counted


def capacity(resources: Resources, nodes: Sequence[dict[str, Any]]) -> int:
    """Return the number of runs that fit on `nodes` at once."""
    return sum(resources.fit_into(node["Resources"]) for node in nodes)


def resource_text(nodes: Sequence[Mapping[str, float]]) -> str:
    """Format the resources of nodes for a message."""
    return "; ".join(
        f"{node.get('CPU', 0):g} CPUs, {node.get('GPU', 0):g} GPUs, {node.get('memory', 0) / GIB:.1f} GiB"
        for node in nodes
    )


def working_nodes() -> list[dict[str, Any]]:
    """Return the live nodes that can be given a run, or all nodes if no worker has joined yet.

    Every run needs some share of a core, which the head node of many clusters does not offer.
    """
    nodes = living_nodes()
    return [node for node in nodes if node["Resources"].get("CPU")] or nodes


def cluster_nodes(address: str, *, gpus: bool, autoscaling: bool) -> Nodes:
    """Return the nodes of a cluster, without joining it.

    With `autoscaling` and a head on this machine, these are the nodes to which the cluster may grow.

    Raises:
        ConnectionError: if no cluster answers at `address`, or it has another token.
    """
    try:
        head = head_address(address)
        resources = resources_at(head)
    except (ConnectionError, RayError) as error:
        raise ConnectionError(connection_advice(address, str(error))) from error
    today = [node for node in resources if node.get("CPU")]
    future = autoscaled_nodes((address, head), gpus=gpus) if autoscaling else []
    if future:
        return Nodes(tuple(future), f"on the {counted(len(future), 'node')} to which the cluster may grow")
    more = ", to which it may add more" if autoscaling else ""
    return Nodes(tuple(today), f"on the cluster's {counted(len(today), 'node')}{more}")


def autoscaled_nodes(heads: Collection[str], *, gpus: bool) -> list[dict[str, float]]:
    """Return the resources of the nodes that the autoscaler on this machine may start, largest first.

    Args:
        heads: possible addresses of the cluster's head.
        gpus: True if runs use GPUs; otherwise the autoscaler starts no nodes with GPUs.
    """
    for process in psutil.process_iter(["cmdline"]):
        flags = dict(part.split("=", 1) for part in process.info["cmdline"] or () if "=" in part)
        if flags.get("--gcs-address") in heads and "--autoscaling-config" in flags:
            config = yaml.safe_load(Path(flags["--autoscaling-config"]).expanduser().read_text())
            break
    else:
        return []
    most = config["max_workers"]
    nodes = [
        {"memory": PLENTY, **kind["resources"]}
        for kind in config["available_node_types"].values()
        if kind["resources"].get("CPU") and (gpus or not kind["resources"].get("GPU"))
        for _ in range(kind.get("max_workers", most))
    ]
    return sorted(nodes, key=lambda node: -node["CPU"])[:most]
