"""The head of a Ray, as a campaign watches it."""

from __future__ import annotations

from typing import Any, Protocol

from ray._private.state import state


class Watched(Protocol):
    """A Ray without which a campaign cannot go on."""

    def lost(self, patience: float) -> str | None:
        """Returns why the head counts as lost after a silence of `patience`, s; None while it does not."""
        ...

    def abandon(self) -> None:
        """Kills what is left of a Ray that this process has started, without any call of Ray."""
        ...


class Head(Watched, Protocol):
    """The head node of a Ray, with the Global Control Store (GCS) that every process of a cluster needs."""

    def nodes(self) -> list[dict[str, Any]]:
        """Returns what Ray knows of each living node: "NodeID", "Resources" and more; never waits for it."""
        ...

    def check(self) -> None:
        """Looks whether the head is there; cheap enough for every turn of a loop.

        Raises:
            HeadLostError: it is lost. This process has left Ray then.
        """
        ...

    def close(self) -> None:
        """Ends the watch; this process stays connected to Ray."""
        ...


def living_nodes() -> list[dict[str, Any]]:
    """Asks Ray for its living nodes; without a head it waits until Ray ends this process."""
    # Unlike `ray.nodes`, it starts no Ray where there is none.
    nodes: list[dict[str, Any]] = state.node_table()  # type: ignore[no-untyped-call]
    return [node for node in nodes if node["Alive"]]
