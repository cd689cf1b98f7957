"""The Ray cluster a campaign runs on: connecting, and how many runs fit."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import ray
from ray.exceptions import AuthenticationError

from tma_ray.campaign.cluster.head import Head, living_nodes
from tma_ray.campaign.cluster.joined import JoinedHead
from tma_ray.campaign.cluster.local import LocalHead
from tma_ray.campaign.preflight.address import check_address, connection_advice
from tma_ray.campaign.preflight.shipping import runtime_environment
from tma_ray.campaign.settings import GIB, Resources
from tma_ray.plugin_source import PluginSource


@dataclass(frozen=True)
class Connection:
    """A connection of this process to Ray.

    Attributes:
        head: of the cluster, watched.
        shipped: whether the workers get the plug-ins; with an older connection they must have them already.
        is_own: whether this process has started that Ray, so that its workers run in the same installation.
    """

    head: Head
    shipped: bool
    is_own: bool


_own: list[LocalHead] = []
"""The Ray that this process has started, if any: like Ray's connection, it outlives a campaign."""


def connect(address: str | None, plugins: Sequence[PluginSource] = ()) -> Connection:
    """Joins the cluster at `address`, or starts a Ray on this machine if that is None.

    An existing connection of this process is used as it is; the address is checked all the same.

    Args:
        address: of a cluster, or "auto".
        plugins: what to bring to the workers.

    Raises:
        ConnectionError: no cluster answers at `address`, or it has another token; nothing is started.
        ValueError: no cluster can be at such an address, or the plug-ins are too large.
    """
    if address is not None:
        check_address(address)
    if ray.is_initialized():
        return _existing()
    _own.clear()
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    # Ray would print the traceback of every run that a campaign no longer waits for.
    os.environ.setdefault("RAY_IGNORE_UNHANDLED_ERRORS", "1")
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
    with runtime_environment(plugins) as environment:
        options["runtime_env"] = environment
        try:
            if address is None:
                _own.append(LocalHead(options))
                return Connection(_own[0], shipped=True, is_own=True)
            ray.init(address=address, **options)
        except (ConnectionError, AuthenticationError) as error:
            raise ConnectionError(connection_advice(address or "local", str(error))) from error
    return Connection(JoinedHead(), shipped=True, is_own=False)


def _existing() -> Connection:
    """Returns the connection that this process has already."""
    if _own and _own[0].is_connected():
        return Connection(_own[0], shipped=False, is_own=True)
    return Connection(JoinedHead(), shipped=False, is_own=False)


def capacity(resources: Resources, nodes: Sequence[dict[str, Any]]) -> int:
    """Returns how many runs `nodes` hold at once."""
    return sum(resources.fit_into(node["Resources"]) for node in nodes)


def check_feasible(resources: Resources) -> None:
    """Refuses runs that no node can hold: Ray would let them wait forever.

    Raises:
        ValueError: what a run needs, and what the nodes have.
    """
    nodes = living_nodes()
    if capacity(resources, nodes):
        return
    have = offers([node["Resources"] for node in nodes])
    raise ValueError(
        f"no node can hold a run of {resources.cpus:g} CPUs, {resources.gpus:g} GPUs and "
        f"{resources.memory_gib:g} GiB: the nodes have {have}; ask for less, add larger nodes, or give "
        f"'--autoscaling' if the cluster adds them by itself"
    )


def offers(nodes: Sequence[Mapping[str, float]]) -> str:
    """Returns the resources of nodes as messages show them."""
    return "; ".join(
        f"{has.get('CPU', 0):g} CPUs, {has.get('GPU', 0):g} GPUs, {has.get('memory', 0) / GIB:.1f} GiB"
        for has in nodes
    )


def working_nodes() -> list[dict[str, Any]]:
    """Returns the living nodes that may get a run, or all where those are still to come.

    Every run needs some share of a core, which the head node of many clusters does not offer.
    """
    nodes = living_nodes()
    return [node for node in nodes if node["Resources"].get("CPU")] or nodes
