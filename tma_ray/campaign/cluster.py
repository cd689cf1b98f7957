"""The Ray cluster a campaign runs on: connecting, and how many runs fit."""

from __future__ import annotations

import logging
import os
import secrets
from collections.abc import Sequence
from typing import Any

import ray
from ray.exceptions import AuthenticationError

from tma_ray.campaign.preflight.address import check_address, connection_advice
from tma_ray.campaign.preflight.shipping import runtime_environment
from tma_ray.campaign.settings import GIB, Resources
from tma_ray.plugin_source import PluginSource

LOCAL_OBJECT_STORE_BYTES = 100_000_000
"""Next to nothing travels through the object store: results go to files."""


def connect(address: str | None, plugins: Sequence[PluginSource] = ()) -> bool:
    """Joins the cluster at `address`, or starts a Ray on this machine if that is None.

    An existing connection of this process is used as it is; the address is checked all the same.

    Args:
        address: of a cluster, or "auto".
        plugins: what to bring to the workers.

    Returns:
        Whether the workers get the plug-ins; with an existing connection they must have them already.

    Raises:
        ConnectionError: no cluster answers at `address`, or it has another token; nothing is started.
        ValueError: no cluster can be at such an address, or the plug-ins are too large.
    """
    if address is not None:
        check_address(address)
    if ray.is_initialized():
        return False
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
    if address is not None:
        options["address"] = address
    else:
        # Ray asks for a token even here, and would write one into the user's home.
        os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))
        local = {"include_dashboard": False, "object_store_memory": LOCAL_OBJECT_STORE_BYTES}
        options |= {"address": "local", **local}
    with runtime_environment(plugins) as environment:
        try:
            ray.init(runtime_env=environment, **options)
        except (ConnectionError, AuthenticationError) as error:
            raise ConnectionError(connection_advice(options["address"], str(error))) from error
    return True


def capacity(resources: Resources) -> int:
    """Returns how many runs the cluster's living nodes hold at once."""
    return sum(resources.fit_into(node["Resources"]) for node in living_nodes())


def check_feasible(resources: Resources) -> None:
    """Refuses runs that no node can hold: Ray would let them wait forever.

    Raises:
        ValueError: what a run needs, and what the nodes have.
    """
    if capacity(resources):
        return
    offers = "; ".join(
        f"{has.get('CPU', 0):g} CPUs, {has.get('GPU', 0):g} GPUs, {has.get('memory', 0) / GIB:.1f} GiB"
        for has in (node["Resources"] for node in living_nodes())
    )
    raise ValueError(
        f"no node can hold a run of {resources.cpus:g} CPUs, {resources.gpus:g} GPUs and "
        f"{resources.memory_gib:g} GiB: the nodes have {offers}; ask for less, add larger nodes, or give "
        f"'--autoscaling' if the cluster adds them by itself"
    )


def working_nodes() -> list[dict[str, Any]]:
    """Returns the living nodes that may get a run, or all where those are still to come.

    Every run needs some share of a core, which the head node of many clusters does not offer.
    """
    nodes = living_nodes()
    return [node for node in nodes if node["Resources"].get("CPU")] or nodes


def living_nodes() -> list[dict[str, Any]]:
    """Returns what Ray knows of each living node: "NodeID", "Resources" and more."""
    nodes: list[dict[str, Any]] = ray.nodes()  # type: ignore[no-untyped-call]
    return [node for node in nodes if node["Alive"]]
