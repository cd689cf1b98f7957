"""The head of a Ray as a campaign watches it, its address, its nodes, and files that are shipped to them."""

import importlib
import os
import re
import socket
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, Protocol

from tma_ray.campaign.settings import GIB, Resources
from tma_ray.components.plugin_source import PluginSource
from tma_ray.console.exit_codes import RAY_LOST


class Watched(Protocol):
    """Ray cluster whose head is watched while a campaign runs."""

    def lost(self, patience: float) -> str | None:
        """Return the reason why the head counts as lost after `patience` seconds of silence; else None."""

    def abandon(self) -> None:
        """Kill the remaining processes of a Ray that this process has started, without any call of Ray."""


class Head(Watched, Protocol):
    """The head node of a Ray, with the Global Control Store (GCS) that every process of a cluster needs."""

    def nodes(self) -> list[dict[str, Any]]:
        """Return Ray's record of each living node, with "NodeID" and "Resources"; never waits for Ray."""

    def check(self) -> None:
        """Check that the head is alive; cheap enough for every turn of a loop.

        Raises:
            HeadLostError: it is lost. This process has left Ray then.
        """

    def close(self) -> None:
        """End the watch; this process stays connected to Ray."""


def living_nodes() -> list[dict[str, Any]]:
    """Ask Ray for its living nodes; without a head it waits until Ray ends this process."""
    from ray._private.state import state  # unlike `ray.nodes`, it starts no Ray where there is none

    nodes: list[dict[str, Any]] = state.node_table()  # type: ignore[no-untyped-call]
    return [node for node in nodes if node["Alive"]]


def capacity(resources: Resources, nodes: Sequence[dict[str, Any]]) -> int:
    """Return the number of runs that `nodes` hold at once."""
    return sum(resources.fit_into(node["Resources"]) for node in nodes)


def offers(nodes: Sequence[Mapping[str, float]]) -> str:
    """Return the resources of nodes as messages show them."""
    return "; ".join(
        f"{has.get('CPU', 0):g} CPUs, {has.get('GPU', 0):g} GPUs, {has.get('memory', 0) / GIB:.1f} GiB"
        for has in nodes
    )


def working_nodes() -> list[dict[str, Any]]:
    """Return the living nodes that may get a run, or all nodes if workers are still to come.

    Every run needs some share of a core, which the head node of many clusters does not offer.
    """
    nodes = living_nodes()
    return [node for node in nodes if node["Resources"].get("CPU")] or nodes


FOLDER = "tma_ray_plugins"  # folder of the shipped files, which a worker finds as a package of that name

MOST_BYTES = 20 * 2**20
"""Largest size of shipped files, in bytes: larger data belongs on the nodes or in storage."""


@contextmanager
def runtime_environment(sources: Sequence[PluginSource]) -> Iterator[dict[str, Any] | None]:
    """Context manager of a Ray runtime environment that brings plug-ins to every worker of a job.

    The files are copied first: what is edited while a campaign runs does not reach its workers.
    Installed packages are not shipped; every node needs them by itself.

    Returns:
        The ``runtime_env`` of `ray.init`, None if there is nothing to ship.

    Raises:
        ValueError: the files are larger than `MOST_BYTES`.
    """
    files = {path: code for each in sources if not each.installed for path, code in each.files.items()}
    total = sum(map(len, files.values()))
    if total > MOST_BYTES:
        largest = max(files, key=lambda path: len(files[path]))
        raise ValueError(
            f"the plug-ins' files are {total / 2**20:.0f} MiB ({largest}: {len(files[largest]) / 2**20:.0f} "
            f"MiB), more than the {MOST_BYTES / 2**20:.0f} MiB that are shipped to workers; install them on "
            f"the nodes, or read large data from a path that all nodes have"
        )
    if not files:
        yield None
        return
    with tempfile.TemporaryDirectory() as place:
        for path, code in files.items():
            file = Path(place, FOLDER, path)
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(code)
        yield {"py_modules": [str(Path(place, FOLDER))]}


def use_shipped() -> None:
    """Put the shipped plug-ins first on the search path of this worker."""
    try:
        shipped = importlib.import_module(FOLDER)
    except ModuleNotFoundError:  # nothing was shipped: all is installed, or Ray was connected before
        return
    root = next(iter(shipped.__path__))
    if root not in sys.path:
        sys.path.insert(0, root)


PROBE_SECONDS = 5.0  # longest wait for a connection to an address, s

_HOST = re.compile(r"[\w.-]+|[0-9a-fA-F:.]*:[0-9a-fA-F:.]+(%\w+)?")
"""A name, an address of IPv4, or one of IPv6."""


def check_address(address: str) -> None:
    """Refuse an address at which a campaign cannot join a cluster.

    Args:
        address: "host:port" of a cluster's head, or "auto": RAY_ADDRESS if set, else the Ray that runs
            on this machine, which is left to Ray to find.

    Raises:
        ValueError: not such an address.
        ConnectionError: nothing listens there.
    """
    if address == "auto":
        address = os.environ.get("RAY_ADDRESS") or "auto"
    place = host_and_port(address)
    if place is None:
        return
    try:
        socket.create_connection(place, timeout=PROBE_SECONDS).close()
    except OSError as error:
        raise ConnectionError(connection_advice(address, f"nothing listens there ({error})")) from error


def host_and_port(address: str) -> tuple[str, int] | None:
    """Return host and port of a cluster's head, None for "auto".

    Raises:
        ValueError: not such an address.
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
    """Return the message of a failed connection to `address`, with its reason and remedies."""
    return (
        f"no Ray cluster was joined at {address!r}: {reason}. From one of its nodes use '--address auto'; "
        f"from elsewhere submit the campaign instead ('ray job submit', 'ray submit'). A cluster that asks "
        f"for a token needs RAY_AUTH_MODE=token and its own ~/.ray/auth_token (or RAY_AUTH_TOKEN_PATH). "
        f"'--local' needs no cluster"
    )


PATIENCE_SECONDS: Final = 20.0  # silence of a head after which a campaign that has not begun is given up, s
LOOK_SECONDS: Final = 1.0  # time between two looks, s
GRACE_SECONDS: Final = 6.0  # time in which a loop that looks after the head itself ends by itself, s

NOT_BEGUN: Final = "no run had been started; give the same command again"

BEGUN: Final = "the same command continues where it was"


@contextmanager
def exit_on_head_loss(
    head: Watched,
    name: str,
    advice: str = NOT_BEGUN,
    *,
    grace: float = 0.0,
    conclude: Callable[[], None] = lambda: None,
) -> Iterator[None]:
    """Context manager that ends this process with a message and `RAY_LOST` if Ray's head is lost.

    A call of Ray waits for a head that is gone until Ray itself ends the process, after 60 s and without a
    word, and cannot be interrupted. The block has `grace` s to notice the loss and end by itself; `conclude`
    is called last and may call nothing of Ray.
    """
    done = threading.Event()

    def watch() -> None:
        while not done.wait(LOOK_SECONDS):
            if head.lost(PATIENCE_SECONDS) is None or done.wait(grace):
                continue
            reason = head.lost(PATIENCE_SECONDS)
            if reason is not None and not done.is_set():
                try:
                    head.abandon()
                    conclude()
                finally:
                    sys.stderr.write(f"{name}: {reason}; {advice}\n")
                    sys.stderr.flush()
                    os._exit(RAY_LOST)

    threading.Thread(target=watch, name="watch-over-ray-head", daemon=True).start()
    try:
        yield
    finally:
        done.set()
