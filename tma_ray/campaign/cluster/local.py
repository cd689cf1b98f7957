"""A Ray of the campaign's own: on this machine, closed to others, and ended with nothing left of it."""

from __future__ import annotations

import atexit
import fcntl
import os
import secrets
import shutil
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import psutil
import ray
from ray._private import ray_constants
from ray.exceptions import AuthenticationError

from tma_ray.campaign.cluster.base import living_nodes
from tma_ray.campaign.failures import HeadLostError

OBJECT_STORE_BYTES: Final = 100_000_000
"""Next to nothing travels through the object store: results go to files."""

CORE: Final = {"gcs_server": "head (GCS)", "raylet": "node manager (raylet)"}
"""Processes without which a Ray cannot go on, by what the system calls them, with their names in messages."""

END_SECONDS: Final = 3.0
"""How long processes that end are waited for, s."""

MARK: Final = "made-by-tma_ray"
"""Name of the file in a folder of ours; nothing is removed without it."""

PREFIX: Final = "tma_ray-"
"""Beginning of the names of these folders."""

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

    def look(self) -> None:
        """Take note of what has been started.

        Core processes are children of this one. The node manager's own children bear its name, too, until
        they become workers, which may end at any time.
        """
        self._started |= set(psutil.Process().children(recursive=True)) - self._others
        for process in set(psutil.Process().children()) - self._others - set(self._core):
            with suppress(psutil.NoSuchProcess):
                name = process.name()
                if name in CORE:
                    self._core[process] = CORE[name]

    def lost(self, patience: float = 0.0) -> str | None:  # noqa: ARG002  # processes are seen at once
        """Return the core processes that are gone, however short the silence; see `Watched`."""
        self.look()
        gone = [name for process, name in self._core.items() if not self._serves(process)]
        if not gone:
            return None
        return (
            f"the {' and the '.join(gone)} of the campaign's own Ray died or was stopped, as by 'ray stop', "
            f"or by the system when memory runs out"
        )

    def abandon(self) -> None:
        """Kill what is left of this Ray, some of which would stay for minutes; see `Watched`."""
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

    def _serves(self, process: psutil.Process) -> bool:
        """Return False if a process has ended or closed its ports: after SIGTERM a head does, and hangs."""
        try:
            if not process.is_running() or process.status() == psutil.STATUS_ZOMBIE:
                return False
            listens = any(each.status == psutil.CONN_LISTEN for each in process.net_connections("tcp"))
        except psutil.NoSuchProcess:
            return False
        if listens:
            self._serving.add(process)
        return listens or process not in self._serving


class LocalHead:
    """The head of a Ray that this process starts, and whose processes are its children.

    All its servers listen on the loopback address only, those for metrics are not started, and every
    request needs a token that only its processes know. Its files are in a folder of this user alone.

    Args:
        options: further options of `ray.init`.

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
        """Kill what is left of this Ray; see `Watched`."""
        self._processes.abandon()

    def close(self) -> None:
        """Do nothing: it is watched without a thread."""

    def _clean(self, folder: Path) -> None:
        """End this Ray and remove its folder, when the interpreter ends: before Ray would end it itself."""
        if self.is_connected():
            ray.shutdown()
        self._processes.wait()
        with suppress(OSError):  # the next Ray of this user removes what is left
            _remove(folder)


def private_folder() -> Path | None:
    """Return a new folder of this user alone in which Ray's can be; None leaves the choice to Ray.

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
    """Remove a folder of ours, its mark last, so that another try finds what was left."""
    if (folder / "ray").exists():
        shutil.rmtree(folder / "ray")
    (folder / MARK).unlink()
    folder.rmdir()
