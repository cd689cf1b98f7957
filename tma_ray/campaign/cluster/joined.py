"""The head of a cluster that a campaign has joined."""

from __future__ import annotations

import logging
import math
import os
import socket
import threading
import time
from typing import Any, Final

import ray
from ray._private.state import state

from tma_ray.campaign.cluster.errors import HeadLostError
from tma_ray.campaign.cluster.head import living_nodes

WATCH_SECONDS: Final = 2.0
"""Time between two looks at a cluster's head, and the longest that it has to accept a connection, s."""

DEFAULT_PATIENCE: Final = 60.0
"""Ray's own default of `PATIENCE_SETTING`, s."""

PATIENCE_SETTING: Final = "gcs_rpc_server_reconnect_timeout_s"
"""After so many s without the head Ray ends every process of the cluster, this one without a word."""

HASTE_SECONDS: Final = 15.0
"""How long before that the campaign ends by itself, s: without a head, leaving Ray takes some 8 s."""

NOTEWORTHY_SECONDS: Final = 10.0
"""Silence of a head that is worth a message, s."""

LOG_SECONDS: Final = 60.0
"""Time between two messages about a head that does not answer, s."""

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
        """Returns the nodes of the last answer; see `Head`."""
        return self._nodes

    def check(self) -> None:
        """Says that the head does not answer, once a minute, and leaves Ray in time; see `Head`."""
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
        """Returns how long the head has not answered, if that is longer than `patience`; see `Head`."""
        silent = time.monotonic() - self._answered
        if silent <= patience:
            return None
        return (
            f"the head of the Ray cluster, {self._address[0]}, has not answered for {silent:.0f} s (Ray "
            f"waits as long as {PATIENCE_SETTING} says): it died, was stopped, or is out of reach"
        )

    def abandon(self) -> None:
        """Does nothing: the cluster is not this process's."""

    def close(self) -> None:
        """Ends the thread."""
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
    """Returns how long this cluster's processes wait for a head that is gone, s."""
    settings: dict[str, Any] = state.get_system_config()  # type: ignore[no-untyped-call]
    return float(
        settings.get(PATIENCE_SETTING) or os.environ.get(f"RAY_{PATIENCE_SETTING}") or DEFAULT_PATIENCE
    )
