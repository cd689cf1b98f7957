"""The Ray cluster a campaign runs on: connecting, and how many runs fit."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import ray

GIB = 2**30

LOCAL_OBJECT_STORE_BYTES = 100_000_000
"""Next to nothing travels through the object store: results go to files."""


@dataclass(frozen=True)
class Resources:
    """What one run occupies.

    Attributes:
        cpus: cores; also the number of torch threads (at least 1).
        gpus: share of a GPU.
        memory_gib: memory in GiB; a SAC run with a full buffer of 2 million transitions takes about 1.
    """

    cpus: float = 1.0
    gpus: float = 0.0
    memory_gib: float = 1.5

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value >= 0:
                raise ValueError(f"{name} = {value}: expected a number of at least 0")
        if self.cpus == 0:
            raise ValueError(
                "cpus = 0: a run needs some share of a core, else Ray starts all of them at once"
            )

    @property
    def threads(self) -> int:
        """Torch's threads per run."""
        return max(1, int(self.cpus))

    def fit_into(self, node: Mapping[str, float]) -> int:
        """Returns how many runs a node with these resources holds at once."""
        needed = {"CPU": self.cpus, "GPU": self.gpus, "memory": self.memory_gib * GIB}
        return min(int(node.get(name, 0.0) / amount) for name, amount in needed.items() if amount > 0)


def connect(address: str | None) -> None:
    """Joins the cluster at `address`, or starts a Ray on this machine if that is None.

    An existing connection of this process is used as it is.

    Raises:
        ConnectionError: no cluster answers at `address`; nothing is started instead.
    """
    if ray.is_initialized():
        return
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    if address is not None:
        ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
        return
    ray.init(
        address="local",
        include_dashboard=False,
        object_store_memory=LOCAL_OBJECT_STORE_BYTES,
        log_to_driver=False,
        logging_level=logging.ERROR,
    )


def capacity(resources: Resources) -> int:
    """Returns how many runs the cluster's living nodes hold at once."""
    return sum(resources.fit_into(node) for node in _nodes())


def check_feasible(resources: Resources) -> None:
    """Refuses runs that no node can hold: Ray would let them wait forever.

    Raises:
        ValueError: what a run needs, and what the nodes have.
    """
    if capacity(resources):
        return
    nodes = _nodes()
    offers = "; ".join(
        f"{node.get('CPU', 0):g} CPUs, {node.get('GPU', 0):g} GPUs, {node.get('memory', 0) / GIB:.1f} GiB"
        for node in nodes
    )
    raise ValueError(
        f"no node can hold a run of {resources.cpus:g} CPUs, {resources.gpus:g} GPUs and "
        f"{resources.memory_gib:g} GiB: the nodes have {offers}; ask for less or add larger nodes"
    )


def _nodes() -> list[dict[str, float]]:
    """Resources of the living nodes."""
    nodes: list[dict[str, Any]] = ray.nodes()  # type: ignore[no-untyped-call]
    return [node["Resources"] for node in nodes if node["Alive"]]
