"""Connections to a private or existing Ray instance, and shipping of plug-ins to its workers."""

import atexit
import fcntl
import importlib
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
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import psutil
import ray
from ray.exceptions import AuthenticationError

from tma_ray.campaign.cluster.protocols import Head
from tma_ray.campaign.cluster.ray_private import living_nodes, loopback_only, system_config
from tma_ray.campaign.failures import LOG_SECONDS, HeadLostError
from tma_ray.campaign.settings import check_address, connection_advice
from tma_ray.components.plugin_source import PluginSource
from tma_ray.runs.placement import usable_cores

OBJECT_STORE_BYTES: Final = 100_000_000
"""Size of the object store, in bytes: hardly anything passes through it, since results go to files."""

CORE: Final = {"gcs_server": "head (GCS)", "raylet": "node manager (raylet)"}
"""Ray's core processes, without which it cannot work: display names by process name."""

HEAD_CHECK_SECONDS: Final = 2.0  # interval between checks of a head, and timeout of each connection to it, s
END_SECONDS: Final = 3.0  # longest wait for processes to end, s
MARK: Final = "made-by-tma_ray"  # marker file in this package's folders; folders without it are never removed
PREFIX: Final = "tma_ray-"  # prefix of the names of this package's folders

MAX_PARENT_BYTES: Final = (103 if sys.platform == "darwin" else 107) - len(
    f"/{PREFIX}12345678/ray/session_2026-01-01_00-00-00_123456_1234567/sockets/plasma_store"
)
"""Longest allowed path of these folders' parent, in bytes: operating systems limit the paths of sockets."""


TOKEN: Final = secrets.token_hex(32)
"""Token shared by all local Ray instances of this process, since Ray caches the first token it reads."""


class LocalRayWatch:
    """Monitor of a local Ray instance's processes, to be created before Ray starts."""

    def __init__(self) -> None:
        self._unrelated = set(psutil.Process().children())
        self._started: set[psutil.Process] = set()
        self._core: dict[psutil.Process, str] = {}
        self._serving: set[psutil.Process] = set()
        self._closed: set[psutil.Process] = set()
        self._refreshed_at = -math.inf

    def refresh(self) -> None:
        """Record new processes, and core processes that have opened or closed ports; takes about 30 ms.

        Core processes are direct children: children of the node manager share its name until they become
        workers, which may end at any time. A head that hangs after SIGTERM has closed its ports.
        """
        self._refreshed_at = time.monotonic()
        self._started |= set(psutil.Process().children(recursive=True)) - self._unrelated
        for process in set(psutil.Process().children()) - self._unrelated - set(self._core):
            with suppress(psutil.NoSuchProcess):
                name = process.name()
                if name in CORE:
                    self._core[process] = CORE[name]
        for process in list(self._core):
            with suppress(psutil.NoSuchProcess):
                if any(port.status == psutil.CONN_LISTEN for port in process.net_connections("tcp")):
                    self._serving.add(process)
                elif process in self._serving:
                    self._closed.add(process)

    def failure_reason(self, patience: float = 0.0) -> str | None:  # noqa: ARG002  # losses are seen at once
        """Return a message that lists the lost core processes, or None if none is lost; see `Watched`."""
        if time.monotonic() - self._refreshed_at >= HEAD_CHECK_SECONDS:
            self.refresh()
        core = list(self._core.items())  # a copy, since another thread may call `refresh`
        gone = [name for process, name in core if process in self._closed or not _lives(process)]
        if not gone:
            return None
        return (
            f"the {' and the '.join(gone)} of the campaign's own Ray died or was stopped, as by 'ray stop', "
            f"or by the system when memory runs out"
        )

    def kill(self) -> None:
        """Kill Ray's remaining processes, since some would outlive Ray by minutes; see `Watched`."""
        self.refresh()
        for process in self._core:
            with suppress(psutil.NoSuchProcess):
                self._started.update(process.children(recursive=True))
        for process in self._started:
            with suppress(psutil.NoSuchProcess):
                process.kill()

    def wait(self) -> None:
        """Wait up to `END_SECONDS` for the processes to end."""
        psutil.wait_procs(self._started, timeout=END_SECONDS)


def _lives(process: psutil.Process) -> bool:
    """Return True if `process` is running and is not a zombie."""
    try:
        return bool(process.is_running() and process.status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False


class LocalHead:
    """Head of a private Ray instance whose processes are children of this process.

    Its servers listen on the loopback address only, metrics servers are off, and every request needs a token
    known only to its processes. Its files are in a folder that only this user can open and that is removed
    at exit.

    Raises:
        HeadLostError: if Ray does not start; its processes have been killed.
    """

    def __init__(self, options: dict[str, Any]) -> None:
        # Without this variable, Ray would write a token into the user's home folder.
        os.environ.setdefault("RAY_AUTH_TOKEN", TOKEN)
        self._watch, self._left = LocalRayWatch(), False
        self._address, folder = "", private_folder()
        if folder is not None:
            options = {**options, "_temp_dir": str(folder / "ray")}
            atexit.register(self._clean, folder)
        try:
            with loopback_only():
                ray.init(
                    address="local",
                    num_cpus=usable_cores(),  # Ray's own core count ignores CPU affinity
                    include_dashboard=False,
                    object_store_memory=OBJECT_STORE_BYTES,
                    _system_config={"enable_metrics_collection": False},
                    **options,
                )
        except Exception as error:
            self._watch.kill()
            if isinstance(error, OSError | ValueError | AuthenticationError):
                raise
            raise HeadLostError(f"the campaign's own Ray did not start: {error}") from error
        self._watch.refresh()
        self._nodes, self._address = living_nodes(), ray.get_runtime_context().gcs_address

    def nodes(self) -> list[dict[str, Any]]:
        """Return the only node; see `Head`."""
        return self._nodes

    def is_connected(self) -> bool:
        """Return True if this process is connected to this Ray instance."""
        return ray.is_initialized() and ray.get_runtime_context().gcs_address == self._address

    def check(self) -> None:
        """Shut down this Ray instance and raise an error if a core process is gone; see `Head`."""
        reason = self._watch.failure_reason()
        if reason is not None:
            self._left = True
            self.kill()
            ray.shutdown()
            self._watch.wait()
            raise HeadLostError(reason)

    def failure_reason(self, patience: float = 0.0) -> str | None:
        """Return a message about lost core processes; None if none is lost or once `check` has raised."""
        return None if self._left else self._watch.failure_reason(patience)

    def kill(self) -> None:
        """Kill the remaining processes of this Ray instance; see `Watched`."""
        self._watch.kill()

    def close(self) -> None:
        """Do nothing, since no thread polls this head."""

    def _clean(self, folder: Path) -> None:
        """Shut down Ray and remove its folder at interpreter exit, before Ray's own exit handler runs."""
        if self.is_connected():
            ray.shutdown()
        self._watch.wait()
        with suppress(OSError):  # leftovers are removed when this user next starts Ray here
            _remove(folder)


def private_folder() -> Path | None:
    """Create and return a private folder for Ray's files, or return None if the user has set RAY_TMPDIR.

    All users of a machine may write into Ray's default folder. This process locks the folder for its
    lifetime; marked folders of this user without a lock are removed.
    """
    if "RAY_TMPDIR" in os.environ:
        return None
    parent = Path(tempfile.gettempdir())
    if len(os.fsencode(parent)) > MAX_PARENT_BYTES:
        parent = Path("/tmp")  # noqa: S108  # a new folder is made there
    for folder in parent.glob(f"{PREFIX}*"):
        with suppress(OSError):  # skip folders that belong to another user, are in use, or hold other files
            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if os.fstat(descriptor).st_uid == os.getuid() and (folder / MARK).is_file():
                    _remove(folder)
            finally:
                os.close(descriptor)
    folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=parent))
    fcntl.flock(os.open(folder, os.O_RDONLY), fcntl.LOCK_EX)
    (folder / MARK).touch()
    return folder


def _remove(folder: Path) -> None:
    """Remove a marked folder, its marker file last, so that an interrupted removal can be repeated."""
    if (folder / "ray").exists():
        shutil.rmtree(folder / "ray")
    (folder / MARK).unlink()
    folder.rmdir()


DEFAULT_PATIENCE: Final = 60.0  # Ray's own default for `PATIENCE_SETTING`, s

PATIENCE_SETTING: Final = "gcs_rpc_server_reconnect_timeout_s"
"""Ray setting: time without a head after which Ray silently ends every process of the cluster, s."""

MARGIN_SECONDS: Final = 15.0
"""Time left for the campaign to end before Ray ends it, s: disconnecting takes about 8 s without a head."""

WARNING_SECONDS: Final = 10.0  # silence of a head after which a warning is logged, s

logger = logging.getLogger(__name__)


class JoinedHead:
    """Head of an existing cluster; a thread polls it for the cluster's nodes.

    A campaign waits for a silent head nearly as long as Ray does (`PATIENCE_SETTING`): a fault-tolerant head
    may come back, and actors continue without it.
    """

    def __init__(self) -> None:
        host, _, port = ray.get_runtime_context().gcs_address.rpartition(":")
        self._address = (host.strip("[]"), int(port))
        setting = system_config().get(PATIENCE_SETTING) or os.environ.get(f"RAY_{PATIENCE_SETTING}")
        patience = float(setting or DEFAULT_PATIENCE)
        self._patience = max(patience - MARGIN_SECONDS, patience / 2)
        self._nodes = living_nodes()
        self._answered, self._logged = time.monotonic(), -math.inf
        self._left = threading.Event()
        threading.Thread(target=self._watch, name="ray-head", daemon=True).start()

    def nodes(self) -> list[dict[str, Any]]:
        """Return the nodes in the head's last answer; see `Head`."""
        return self._nodes

    def check(self) -> None:
        """Warn once a minute while the head is silent, and disconnect before Ray would end this process."""
        silent = time.monotonic() - self._answered
        if silent < WARNING_SECONDS:
            return
        reason = self.failure_reason(self._patience)
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

    def failure_reason(self, patience: float) -> str | None:
        """Return a message if the head has been silent for over `patience` s, else None; see `Watched`."""
        silent = time.monotonic() - self._answered
        if silent <= patience:
            return None
        return (
            f"the head of the Ray cluster, {self._address[0]}, has not answered for {silent:.0f} s (Ray "
            f"waits as long as {PATIENCE_SETTING} says): it died, was stopped, or is out of reach"
        )

    def kill(self) -> None:
        """Do nothing, since this process has not started the cluster."""

    def close(self) -> None:
        """Stop the thread."""
        self._left.set()

    def _watch(self) -> None:
        while not self._left.wait(HEAD_CHECK_SECONDS):
            try:
                socket.create_connection(self._address, timeout=HEAD_CHECK_SECONDS).close()
                self._nodes = living_nodes()
                self._answered = time.monotonic()
            except Exception as error:  # also catches Ray's errors, such as those raised after a shutdown
                logger.debug("the head of the Ray cluster does not answer: %s", error)


@dataclass(frozen=True)
class Connection:
    """Connection of this process to Ray.

    Attributes:
        head: monitored head.
        shipped: True if plug-ins were shipped to the workers, which is only possible on a new connection.
        is_own: True if this process started Ray, whose workers then use the same installation.
    """

    head: Head
    shipped: bool
    is_own: bool


_local: list[LocalHead] = []
"""Private Ray instance of this process, if any; like Ray's connection, it outlives a campaign."""


def connect(address: str | None, plugins: Sequence[PluginSource] = ()) -> Connection:
    """Join the cluster at `address`, or start Ray on this machine if `address` is None.

    An existing connection of this process is reused, after checking the address.

    Raises:
        ConnectionError: if no cluster answers at `address`, or it has another token; nothing is started.
        ValueError: if the address is malformed, or the plug-ins are too large.
    """
    if address is not None:
        check_address(address)
    if ray.is_initialized():
        is_own = bool(_local) and _local[0].is_connected()
        return Connection(_local[0] if is_own else JoinedHead(), shipped=False, is_own=is_own)
    _local.clear()
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    # Print no tracebacks of runs that a campaign no longer waits for.
    os.environ.setdefault("RAY_IGNORE_UNHANDLED_ERRORS", "1")
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
    with runtime_environment(plugins) as environment:
        options["runtime_env"] = environment
        try:
            if address is None:
                _local.append(LocalHead(options))
                return Connection(_local[0], shipped=True, is_own=True)
            ray.init(address=address, **options)
        except (ConnectionError, AuthenticationError) as error:
            raise ConnectionError(connection_advice(address or "local", str(error))) from error
    return Connection(JoinedHead(), shipped=True, is_own=False)


PACKAGE = "tma_ray_plugins"  # name of the shipped folder, which workers import as a package

MAX_SHIPPED_BYTES = 20 * 2**20
"""Largest size of shipped files, in bytes: larger data belongs on the nodes or in storage."""


@contextmanager
def runtime_environment(sources: Sequence[PluginSource]) -> Iterator[dict[str, Any] | None]:
    """Context manager that yields a Ray runtime environment with plug-ins for all workers of a job.

    It ships copies: edits during a campaign do not reach the workers. Installed packages are not shipped;
    every node needs them.

    Returns:
        The ``runtime_env`` of `ray.init`, None if there is nothing to ship.

    Raises:
        ValueError: if the files are larger than `MAX_SHIPPED_BYTES`.
    """
    files = {path: code for source in sources if not source.installed for path, code in source.files.items()}
    total = sum(map(len, files.values()))
    if total > MAX_SHIPPED_BYTES:
        largest = max(files, key=lambda path: len(files[path]))
        raise ValueError(
            f"the plug-ins' files are {total / 2**20:.0f} MiB ({largest}: {len(files[largest]) / 2**20:.0f} "
            f"MiB), more than the {MAX_SHIPPED_BYTES / 2**20:.0f} MiB that are shipped to workers; install "
            f"them on the nodes, or read large data from a path that all nodes have"
        )
    if not files:
        yield None
        return
    with tempfile.TemporaryDirectory() as folder:
        package = Path(folder, PACKAGE)
        for path, code in files.items():
            (package / path).parent.mkdir(parents=True, exist_ok=True)
            (package / path).write_bytes(code)
        yield {"py_modules": [str(package)]}


def use_shipped() -> None:
    """Put the shipped plug-ins first on this worker's module search path."""
    try:
        shipped = importlib.import_module(PACKAGE)
    except ModuleNotFoundError:  # nothing was shipped
        return
    root = next(iter(shipped.__path__))
    if root not in sys.path:
        sys.path.insert(0, root)
