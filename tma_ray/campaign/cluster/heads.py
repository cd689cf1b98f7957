"""The heads of both kinds of Ray: one of the campaign's own on this machine, and that of a joined cluster.

A Ray of the campaign's own is closed to others, and ends with nothing left of it.
"""

import atexit
import fcntl
import logging
import math
import os
import secrets
import shutil
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import psutil
import ray
import yaml
from ray._private import ray_constants, services
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
from tma_ray.campaign.failures import LOG_SECONDS, HeadLostError
from tma_ray.campaign.settings import PLENTY, Nodes
from tma_ray.components.plugin_source import PluginSource
from tma_ray.runs.placement import usable_cores
from tma_ray.support.texts import counted

OBJECT_STORE_BYTES: Final = 100_000_000
"""Next to nothing travels through the object store: results go to files."""

CORE: Final = {"gcs_server": "head (GCS)", "raylet": "node manager (raylet)"}
"""Processes without which a Ray cannot go on, by what the system calls them, with their names in messages."""

WATCH_SECONDS: Final = 2.0
"""Time between two looks at a head, and the longest that it has to accept a connection, s."""

END_SECONDS: Final = 3.0  # longest wait for processes that end, s
MARK: Final = "made-by-tma_ray"  # name of the file in a folder of ours; nothing is removed without it
PREFIX: Final = "tma_ray-"  # beginning of the names of these folders

LONGEST_PLACE: Final = (103 if sys.platform == "darwin" else 107) - len(
    f"/{PREFIX}12345678/ray/session_2026-01-01_00-00-00_123456_1234567/sockets/plasma_store"
)
"""Longest path of the folder that holds ours, in bytes: systems bound the paths of sockets."""


TOKEN: Final = secrets.token_hex(32)
"""Token of this process's Rays: one for all, since Ray keeps the first that it reads."""


class OwnProcesses:
    """Processes of the Ray that this process starts from now on, watched while it starts and afterwards."""

    def __init__(self) -> None:
        self._others = set(psutil.Process().children())
        self._started: set[psutil.Process] = set()
        self._core: dict[psutil.Process, str] = {}
        self._serving: set[psutil.Process] = set()
        self._silent: set[psutil.Process] = set()
        self._looked = -math.inf

    def look(self) -> None:
        """Record the processes that have been started, and which of the core serve; takes some 30 ms.

        Core processes are children of this one. The node manager's own children bear its name, too, until
        they become workers, which may end at any time. A head that hangs after SIGTERM has closed its ports.
        """
        self._looked = time.monotonic()
        self._started |= set(psutil.Process().children(recursive=True)) - self._others
        for process in set(psutil.Process().children()) - self._others - set(self._core):
            with suppress(psutil.NoSuchProcess):
                name = process.name()
                if name in CORE:
                    self._core[process] = CORE[name]
        for process in list(self._core):
            with suppress(psutil.NoSuchProcess):
                if any(each.status == psutil.CONN_LISTEN for each in process.net_connections("tcp")):
                    self._serving.add(process)
                elif process in self._serving:
                    self._silent.add(process)

    def lost(self, patience: float = 0.0) -> str | None:  # noqa: ARG002  # processes are seen at once
        """Return the core processes that have ended or closed their ports; see `Watched`."""
        if time.monotonic() - self._looked >= WATCH_SECONDS:
            self.look()
        core = list(self._core.items())  # another thread may look
        gone = [name for process, name in core if process in self._silent or not _lives(process)]
        if not gone:
            return None
        return (
            f"the {' and the '.join(gone)} of the campaign's own Ray died or was stopped, as by 'ray stop', "
            f"or by the system when memory runs out"
        )

    def abandon(self) -> None:
        """Kill the remaining processes of this Ray, some of which would live for minutes; see `Watched`."""
        self.look()
        for process in self._core:
            with suppress(psutil.NoSuchProcess):
                self._started.update(process.children(recursive=True))
        for process in self._started:
            with suppress(psutil.NoSuchProcess):
                process.kill()

    def wait(self) -> None:
        """Wait a moment for processes that end."""
        psutil.wait_procs(self._started, timeout=END_SECONDS)


def _lives(process: psutil.Process) -> bool:
    """Return False if a process has ended, whether or not its end has been collected."""
    try:
        return bool(process.is_running() and process.status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False


class LocalHead:
    """The head of a Ray that this process starts, and whose processes are its children.

    All its servers listen on the loopback address only, those for metrics are not started, and every
    request needs a token that only its processes know. Its files are in a folder of this user alone.

    Raises:
        HeadLostError: Ray gave up while it started; nothing of it is left.
    """

    def __init__(self, options: dict[str, Any]) -> None:
        # Ray asks for a token even here, and would write one into the user's home.
        os.environ.setdefault("RAY_AUTH_TOKEN", TOKEN)
        self._processes, self._left = OwnProcesses(), False
        self._address, folder = "", private_folder()
        if folder is not None:
            options = {**options, "_temp_dir": str(folder / "ray")}
            atexit.register(self._clean, folder)
        # Where it forms no clusters (macOS, Windows), Ray takes the loopback address for its node's, and all
        # its servers listen there alone. It has no option for that, and replaces such an address.
        before, ray_constants.ENABLE_RAY_CLUSTER = ray_constants.ENABLE_RAY_CLUSTER, False
        try:
            ray.init(
                address="local",
                num_cpus=usable_cores(),  # Ray counts the machine's, whatever this process's affinity
                include_dashboard=False,
                object_store_memory=OBJECT_STORE_BYTES,
                _system_config={"enable_metrics_collection": False},
                **options,
            )
        except Exception as error:
            self._processes.abandon()
            if isinstance(error, OSError | ValueError | AuthenticationError):
                raise
            raise HeadLostError(f"the campaign's own Ray did not start: {error}") from error
        finally:
            ray_constants.ENABLE_RAY_CLUSTER = before
        self._processes.look()
        self._nodes, self._address = living_nodes(), ray.get_runtime_context().gcs_address

    def nodes(self) -> list[dict[str, Any]]:
        """Return the one node; see `Head`."""
        return self._nodes

    def is_connected(self) -> bool:
        """Return True if this process is connected to this very Ray."""
        return ray.is_initialized() and ray.get_runtime_context().gcs_address == self._address

    def check(self) -> None:
        """End this Ray if one of its core processes is gone; see `Head`."""
        reason = self._processes.lost()
        if reason is not None:
            self._left = True
            self.abandon()
            ray.shutdown()
            self._processes.wait()
            raise HeadLostError(reason)

    def lost(self, patience: float = 0.0) -> str | None:
        """Return the core processes that are gone, None once `check` has found it out; see `Watched`."""
        return None if self._left else self._processes.lost(patience)

    def abandon(self) -> None:
        """Kill the remaining processes of this Ray; see `Watched`."""
        self._processes.abandon()

    def close(self) -> None:
        """Do nothing: the processes are watched without a thread."""

    def _clean(self, folder: Path) -> None:
        """End this Ray and remove its folder when the interpreter exits, before Ray's own exit handler."""
        if self.is_connected():
            ray.shutdown()
        self._processes.wait()
        with suppress(OSError):  # the next Ray of this user removes what is left
            _remove(folder)


def private_folder() -> Path | None:
    """Return a new private folder for Ray's files; None leaves the choice to Ray.

    Ray lets all users of the machine write into its own folder, whose path must be short because of sockets.
    This process holds a lock on the folder as long as it lives; folders of ours without one are removed.
    """
    if "RAY_TMPDIR" in os.environ:
        return None
    place = Path(tempfile.gettempdir())
    if len(os.fsencode(place)) > LONGEST_PLACE:
        place = Path("/tmp")  # noqa: S108  # a new folder is made there
    for folder in place.glob(f"{PREFIX}*"):
        # Those of others, in use, or with what neither we nor Ray have put there stay.
        with suppress(OSError):
            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if os.fstat(descriptor).st_uid == os.getuid() and (folder / MARK).is_file():
                    _remove(folder)
            finally:
                os.close(descriptor)
    folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=place))
    fcntl.flock(os.open(folder, os.O_RDONLY), fcntl.LOCK_EX)
    (folder / MARK).touch()
    return folder


def _remove(folder: Path) -> None:
    """Remove a folder of ours, its mark last, so that an interrupted removal can be repeated."""
    if (folder / "ray").exists():
        shutil.rmtree(folder / "ray")
    (folder / MARK).unlink()
    folder.rmdir()


DEFAULT_PATIENCE: Final = 60.0  # Ray's own default of `PATIENCE_SETTING`, s

PATIENCE_SETTING: Final = "gcs_rpc_server_reconnect_timeout_s"
"""After so many s without the head Ray ends every process of the cluster, this one without a word."""

HASTE_SECONDS: Final = 15.0
"""Time before that at which the campaign ends by itself, s: without a head, leaving Ray takes some 8 s."""

NOTEWORTHY_SECONDS: Final = 10.0  # silence of a head that is worth a message, s
ANSWER_SECONDS: Final = 10  # time in which a head has to list its nodes, s
ALIVE: Final = 0  # state of a node in the head's list that is there

logger = logging.getLogger(__name__)


class JoinedHead:
    """The head of a cluster that this process has joined, asked for its nodes in a thread.

    A head that is gone is waited for as long as Ray itself waits (`PATIENCE_SETTING`): with fault tolerance
    it may come back, and actors go on meanwhile.
    """

    def __init__(self) -> None:
        host, _, port = ray.get_runtime_context().gcs_address.rpartition(":")
        self._address = (host.strip("[]"), int(port))
        settings: dict[str, Any] = state.get_system_config()  # type: ignore[no-untyped-call]
        own = settings.get(PATIENCE_SETTING) or os.environ.get(f"RAY_{PATIENCE_SETTING}")
        patience = float(own or DEFAULT_PATIENCE)
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


def cluster_nodes(address: str, *, gpus: bool, autoscaling: bool) -> Nodes:
    """Return the nodes of a cluster, without joining it.

    With `autoscaling` they are those to which it may grow, where this machine is its head and knows them.

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
    """Return the nodes that the autoscaler on this machine may still start, the largest first.

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
    """A connection of this process to Ray: its watched head, and two facts.

    With an older connection no plug-ins are `shipped`: the workers must have them. The workers of a Ray that
    `is_own`, started by this process, run in the same installation.
    """

    head: Head
    shipped: bool
    is_own: bool


_own: list[LocalHead] = []
"""The Ray that this process has started, if any: like Ray's connection, it outlives a campaign."""


def connect(address: str | None, plugins: Sequence[PluginSource] = ()) -> Connection:
    """Join the cluster at `address`, or start a Ray on this machine if that is None.

    An existing connection of this process is used as it is; the address is checked all the same.

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
