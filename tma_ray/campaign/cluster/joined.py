"""Connections to Ray, and the head of a cluster that a campaign joins."""

from __future__ import annotations

import logging
import math
import os
import socket
import threading
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import psutil
import ray
import yaml
from ray._private import services
from ray._private.state import state
from ray._raylet import GcsClient  # type: ignore[attr-defined]  # compiled
from ray.exceptions import AuthenticationError, RayError

from tma_ray.campaign.cluster.base import (
    Head,
    check_address,
    connection_advice,
    living_nodes,
    runtime_environment,
)
from tma_ray.campaign.cluster.local import LocalHead
from tma_ray.campaign.failures import HeadLostError
from tma_ray.campaign.settings import PLENTY, Nodes
from tma_ray.commands.texts import counted
from tma_ray.plugin_source import PluginSource

WATCH_SECONDS: Final = 2.0
"""Time between two looks at a cluster's head, and the longest that it has to accept a connection, s."""

DEFAULT_PATIENCE: Final = 60.0
"""Ray's own default of `PATIENCE_SETTING`, s."""

PATIENCE_SETTING: Final = "gcs_rpc_server_reconnect_timeout_s"
"""After so many s without the head Ray ends every process of the cluster, this one without a word."""

HASTE_SECONDS: Final = 15.0
"""Time before that at which the campaign ends by itself, s: without a head, leaving Ray takes some 8 s."""

NOTEWORTHY_SECONDS: Final = 10.0
"""Silence of a head that is worth a message, s."""

LOG_SECONDS: Final = 60.0
"""Time between two messages about a head that does not answer, s."""

ANSWER_SECONDS: Final = 10
"""Time in which a head has to list its nodes, s."""

ALIVE: Final = 0
"""State of a node in the head's list that is there."""

logger = logging.getLogger(__name__)


class JoinedHead:
    """The head of a cluster that this process has joined, asked for its nodes in a thread.

    A head that is gone is waited for as long as Ray itself waits (`PATIENCE_SETTING`): with fault tolerance
    it may come back, and actors go on meanwhile.
    """

    def __init__(self) -> None:
        host, _, port = ray.get_runtime_context().gcs_address.rpartition(":")
        self._address = (host.strip("[]"), int(port))
        patience = patience_of_ray()
        self._patience = max(patience - HASTE_SECONDS, patience / 2)
        self._nodes = living_nodes()
        self._answered, self._logged = time.monotonic(), -math.inf
        self._left = threading.Event()
        threading.Thread(target=self._watch, name="ray-head", daemon=True).start()

    def nodes(self) -> list[dict[str, Any]]:
        """Return the nodes of the last answer; see `Head`."""
        return self._nodes

    def check(self) -> None:
        """Say that the head does not answer, once a minute, and leave Ray in time; see `Head`."""
        silent = time.monotonic() - self._answered
        if silent < NOTEWORTHY_SECONDS:
            return
        reason = self.lost(self._patience)
        if reason is not None:
            self.close()
            ray.shutdown()
            raise HeadLostError(reason)
        if time.monotonic() - self._logged > LOG_SECONDS:
            self._logged = time.monotonic()
            logger.warning(
                "the head of the Ray cluster, %s, does not answer; it is waited for another %.0f s",
                self._address[0],
                self._patience - silent,
            )

    def lost(self, patience: float) -> str | None:
        """Return the time without an answer of the head, if it exceeds `patience`; see `Head`."""
        silent = time.monotonic() - self._answered
        if silent <= patience:
            return None
        return (
            f"the head of the Ray cluster, {self._address[0]}, has not answered for {silent:.0f} s (Ray "
            f"waits as long as {PATIENCE_SETTING} says): it died, was stopped, or is out of reach"
        )

    def abandon(self) -> None:
        """Do nothing: the cluster is not this process's."""

    def close(self) -> None:
        """End the thread."""
        self._left.set()

    def _watch(self) -> None:
        while not self._left.wait(WATCH_SECONDS):
            try:
                socket.create_connection(self._address, timeout=WATCH_SECONDS).close()
                self._nodes = living_nodes()
                self._answered = time.monotonic()
            except Exception as error:  # of Ray's too, such as after a shutdown
                logger.debug("the head of the Ray cluster does not answer: %s", error)


def patience_of_ray() -> float:
    """Return the time for which this cluster's processes wait for a lost head, s."""
    settings: dict[str, Any] = state.get_system_config()  # type: ignore[no-untyped-call]
    return float(
        settings.get(PATIENCE_SETTING) or os.environ.get(f"RAY_{PATIENCE_SETTING}") or DEFAULT_PATIENCE
    )


def cluster_nodes(address: str, *, gpus: bool, autoscaling: bool) -> Nodes:
    """Return the nodes of a cluster, without joining it.

    Args:
        address: "host:port" of its head, or "auto".
        gpus: True if runs use GPUs.
        autoscaling: True for the nodes to which it may grow, where this machine is its head and knows them.

    Raises:
        ConnectionError: no cluster answers at `address`, or it has another token.
    """
    try:
        head = services.canonicalize_bootstrap_address_or_die(address)
        found = GcsClient(address=head).get_all_node_info(timeout=ANSWER_SECONDS).values()
    except (ConnectionError, RayError) as error:
        raise ConnectionError(connection_advice(address, str(error))) from error
    today = [dict(node.resources_total) for node in found if node.state == ALIVE]
    today = [node for node in today if node.get("CPU")]
    to_come = nodes_to_come((address, head), gpus=gpus) if autoscaling else []
    if to_come:
        return Nodes(tuple(to_come), f"on the {counted(len(to_come), 'node')} to which the cluster may grow")
    more = ", to which it may add more" if autoscaling else ""
    return Nodes(tuple(today), f"on the cluster's {counted(len(today), 'node')}{more}")


def nodes_to_come(heads: Collection[str], *, gpus: bool) -> list[dict[str, float]]:
    """Return the nodes to which a cluster may grow whose autoscaler runs on this machine, the largest first.

    Args:
        heads: addresses of its head.
        gpus: True if runs use GPUs: for others the autoscaler starts no nodes with some.
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


@dataclass(frozen=True)
class Connection:
    """A connection of this process to Ray.

    Attributes:
        head: head of the cluster, watched.
        shipped: True if the workers get the plug-ins; with an older connection they must have them already.
        is_own: True if this process has started that Ray, so that its workers run in the same installation.
    """

    head: Head
    shipped: bool
    is_own: bool


_own: list[LocalHead] = []
"""The Ray that this process has started, if any: like Ray's connection, it outlives a campaign."""


def connect(address: str | None, plugins: Sequence[PluginSource] = ()) -> Connection:
    """Join the cluster at `address`, or start a Ray on this machine if that is None.

    An existing connection of this process is used as it is; the address is checked all the same.

    Args:
        address: address of a cluster, or "auto".
        plugins: sources of plug-ins to ship to the workers.

    Raises:
        ConnectionError: no cluster answers at `address`, or it has another token; nothing is started.
        ValueError: no cluster can be at such an address, or the plug-ins are too large.
    """
    if address is not None:
        check_address(address)
    if ray.is_initialized():
        is_own = bool(_own) and _own[0].is_connected()
        return Connection(_own[0] if is_own else JoinedHead(), shipped=False, is_own=is_own)
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
