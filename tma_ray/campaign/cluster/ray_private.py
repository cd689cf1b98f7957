"""Wrappers around Ray's private API; no other module uses it.

Docstrings give the reason why the public API does not suffice, and the test that fails if Ray changes.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from ray._private import ray_constants, services, worker
from ray._private.state import state
from ray._raylet import GcsClient  # type: ignore[attr-defined]  # compiled

ANSWER_SECONDS: Final = 10  # time limit for a head to list its nodes, s
ALIVE: Final = 0  # state of a live node in the head's list


def living_nodes() -> list[dict[str, Any]]:
    """Return Ray's records of live nodes.

    Without a head, the call blocks until Ray ends this process. `ray.nodes` would start Ray if none runs.
    Tested by ``tests/campaign/test_own_ray.py``.
    """
    nodes: list[dict[str, Any]] = state.node_table()  # type: ignore[no-untyped-call]
    return [node for node in nodes if node["Alive"]]


def system_config() -> dict[str, Any]:
    """Return the settings with which the head was started.

    Ray has no public function for them. Tested by ``tests/campaign/test_joined_head.py``.
    """
    settings: dict[str, Any] = state.get_system_config()  # type: ignore[no-untyped-call]
    return settings


def head_address(address: str) -> str:
    """Return the "host:port" of the head to which an `address` such as "auto" refers.

    The only public function that resolves it, `ray.init`, also connects.
    Tested by ``tests/campaign/test_joined_head.py``.

    Raises:
        ConnectionError: if no head is found.
    """
    head: str = services.canonicalize_bootstrap_address_or_die(address)
    return head


def resources_at(head: str) -> list[dict[str, float]]:
    """Return the resources of each live node of a cluster, without joining it.

    The public API needs the dashboard. Tested by ``tests/campaign/test_joined_head.py``.

    Raises:
        ray.exceptions.RayError: if no head answers at this "host:port", or it has another token.
    """
    nodes = GcsClient(address=head).get_all_node_info(timeout=ANSWER_SECONDS).values()
    return [dict(node.resources_total) for node in nodes if node.state == ALIVE]


@contextmanager
def loopback_only() -> Iterator[None]:
    """Context manager in which a new local Ray instance listens only on the loopback address.

    Ray does so where it forms no clusters (macOS, Windows); elsewhere it replaces a loopback address.
    Tested by ``tests/campaign/test_own_ray.py``.
    """
    before, ray_constants.ENABLE_RAY_CLUSTER = ray_constants.ENABLE_RAY_CLUSTER, False
    try:
        yield
    finally:
        ray_constants.ENABLE_RAY_CLUSTER = before


def sockets_folder() -> Path:
    """Return the folder of Ray's sockets on this node; its path is short.

    Ray has no public name for it. Tested by ``tests/campaign/test_cohorts.py``.
    """
    node: Any = worker.global_worker.node
    return Path(node.get_sockets_dir_path())
