"""Addresses of Ray clusters, and their nodes and resources."""

import os
import re
import socket
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import psutil
import yaml
from ray.exceptions import RayError

from tma_ray.campaign.cluster.ray_private import head_address, living_nodes, resources_at
from tma_ray.campaign.settings import GIB, PLENTY, Nodes, Resources
from tma_ray.support.texts import counted

PROBE_SECONDS: Final = 5.0  # longest wait for a connection to an address, s

_HOST: Final = re.compile(r"[\w.-]+|[0-9a-fA-F:.]*:[0-9a-fA-F:.]+(%\w+)?")
"""Pattern of a host name or an IP address."""


def check_address(address: str) -> None:
    """Check that a campaign could join a cluster at this address.

    Args:
        address: "host:port" of a cluster's head, or "auto": RAY_ADDRESS if set, else the Ray on this
            machine, which Ray finds itself.

    Raises:
        ValueError: if the address is malformed.
        ConnectionError: if nothing listens there.
    """
    if address == "auto":
        address = os.environ.get("RAY_ADDRESS") or "auto"
    head = host_and_port(address)
    if head is None:
        return
    try:
        socket.create_connection(head, timeout=PROBE_SECONDS).close()
    except OSError as error:
        raise ConnectionError(connection_advice(address, f"nothing listens there ({error})")) from error


def host_and_port(address: str) -> tuple[str, int] | None:
    """Return the host and port of a cluster's head, or None for "auto".

    Raises:
        ValueError: if the address is malformed.
    """
    if address == "auto":
        return None
    if "://" in address:
        raise ValueError(
            f"address {address!r} is for Ray's own tools, and no campaign can run through it: its driver "
            f"belongs on the cluster, where its address is 'auto'; get it there with "
            f"'ray job submit --address http://127.0.0.1:8265 -- python SCRIPT --address auto'"
        )
    host, separator, port = address.rpartition(":")
    host = host.strip("[]")
    if not (separator and _HOST.fullmatch(host) and port.isdecimal() and 0 < int(port) < 2**16):
        raise ValueError(
            f"address {address!r}: expected 'auto' or the head's 'host:port', as in 10.0.0.5:6379"
        )
    return host, int(port)


def connection_advice(address: str, reason: str) -> str:
    """Return a message on a failed connection to `address`, with its cause and remedies."""
    return (
        f"no Ray cluster was joined at {address!r}: {reason}. From one of its nodes use '--address auto'; "
        f"from elsewhere submit the campaign instead ('ray job submit', 'ray submit'). A cluster that asks "
        f"for a token needs RAY_AUTH_MODE=token and its own ~/.ray/auth_token (or RAY_AUTH_TOKEN_PATH). "
        f"'--local' needs no cluster"
    )


def capacity(resources: Resources, nodes: Sequence[dict[str, Any]]) -> int:
    """Return the number of runs that fit on `nodes` at once."""
    return sum(resources.fit_into(node["Resources"]) for node in nodes)


def resource_text(nodes: Sequence[Mapping[str, float]]) -> str:
    """Describe the resources of nodes for messages."""
    return "; ".join(
        f"{node.get('CPU', 0):g} CPUs, {node.get('GPU', 0):g} GPUs, {node.get('memory', 0) / GIB:.1f} GiB"
        for node in nodes
    )


def working_nodes() -> list[dict[str, Any]]:
    """Return the live nodes that may get a run, or all nodes if no worker has joined yet.

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
    """Return the nodes that the autoscaler on this machine may start, largest first.

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
