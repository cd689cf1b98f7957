"""A Ray of the campaign's own: on this machine, closed to others, and ended with nothing left of it."""

from __future__ import annotations

import os
import secrets
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, Final

import psutil
import ray
from ray._private import ray_constants
from ray.exceptions import AuthenticationError

from tma_ray.campaign.cluster.errors import HeadLostError
from tma_ray.campaign.cluster.head import living_nodes

OBJECT_STORE_BYTES: Final = 100_000_000
"""Next to nothing travels through the object store: results go to files."""

CORE: Final = {"gcs_server": "head (GCS)", "raylet": "node manager (raylet)"}
"""Processes without which a Ray cannot go on, by what the system calls them, with their names in messages."""

END_SECONDS: Final = 3.0
"""How long killed processes are waited for, s."""


class OwnProcesses:
    """Processes of the Ray that this process starts from now on, watched while it starts and afterwards."""

    def __init__(self) -> None:
        self._others = set(psutil.Process().children())
        self._started: set[psutil.Process] = set()
        self._core: dict[psutil.Process, str] = {}

    def look(self) -> None:
        """Takes note of what has been started.

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
        """Returns which core processes are gone, however short the silence; see `Watched`."""
        self.look()
        gone = [name for process, name in self._core.items() if not _lives(process)]
        if not gone:
            return None
        return (
            f"the {' and the '.join(gone)} of the campaign's own Ray died or was stopped, as by 'ray stop', "
            f"or by the system when memory runs out"
        )

    def abandon(self) -> None:
        """Kills what is left of this Ray, some of which would stay for minutes; see `Watched`."""
        self.look()
        for process in self._core:
            with suppress(psutil.NoSuchProcess):
                self._started.update(process.children(recursive=True))
        for process in self._started:
            with suppress(psutil.NoSuchProcess):
                process.kill()

    def wait(self) -> None:
        """Waits a moment for killed processes."""
        psutil.wait_procs(self._started, timeout=END_SECONDS)


class LocalHead:
    """The head of a Ray that this process starts, and whose processes are its children.

    All its servers listen on the loopback address only, those for metrics are not started, and every
    request needs a token that only its processes know. Its files are in a folder of this user alone.

    Args:
        options: of `ray.init`, more than those that make it local.

    Raises:
        HeadLostError: Ray gave up while it started; nothing of it is left.
    """

    def __init__(self, options: dict[str, Any]) -> None:
        # Ray asks for a token even here, and would write one into the user's home.
        os.environ.setdefault("RAY_AUTH_TOKEN", _own_token())
        self._processes, self._left = OwnProcesses(), False
        try:
            with _loopback():
                ray.init(
                    address="local",
                    include_dashboard=False,
                    object_store_memory=OBJECT_STORE_BYTES,
                    _system_config={"enable_metrics_collection": False},
                    _temp_dir=private_folder(),
                    **options,
                )
        except Exception as error:
            self._processes.abandon()
            if isinstance(error, OSError | ValueError | AuthenticationError):
                raise
            raise HeadLostError(f"the campaign's own Ray did not start: {error}") from error
        self._processes.look()
        self._nodes, self._address = living_nodes(), ray.get_runtime_context().gcs_address

    def nodes(self) -> list[dict[str, Any]]:
        """Returns the one node; see `Head`."""
        return self._nodes

    def is_connected(self) -> bool:
        """Tells whether this process is connected to this very Ray."""
        return ray.is_initialized() and ray.get_runtime_context().gcs_address == self._address

    def check(self) -> None:
        """Ends this Ray if one of its core processes is gone; see `Head`."""
        reason = self._processes.lost()
        if reason is not None:
            self._left = True
            self.abandon()
            ray.shutdown()
            self._processes.wait()
            raise HeadLostError(reason)

    def lost(self, patience: float = 0.0) -> str | None:
        """Returns which core processes are gone, None once `check` has found it out; see `Watched`."""
        return None if self._left else self._processes.lost(patience)

    def abandon(self) -> None:
        """Kills what is left of this Ray; see `Watched`."""
        self._processes.abandon()

    def close(self) -> None:
        """Does nothing: it is watched without a thread."""


@cache
def _own_token() -> str:
    """Returns the token of this process's Rays: one for all, since Ray keeps the first that it reads."""
    return secrets.token_hex(32)


def private_folder() -> str | None:
    """Returns where Ray's files go: logs, and sockets whose paths must be short; None leaves it to Ray.

    Ray lets all users of the machine write into its own choice.
    """
    if "RAY_TMPDIR" in os.environ or not hasattr(os, "getuid"):
        return None
    folder = Path(tempfile.gettempdir(), f"tma_ray-{os.getuid()}")
    with suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    found = folder.lstat()
    ours = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o077
    return str(folder) if ours else tempfile.mkdtemp(prefix=f"{folder.name}-")


@contextmanager
def _loopback() -> Iterator[None]:
    """Has a Ray that is started in the block take the loopback address for that of its node.

    Ray does so by itself where it forms no clusters (macOS, Windows), and then lets all its servers listen
    there alone. It has no option for it, and replaces an address of this kind that it is given.
    """
    before = ray_constants.ENABLE_RAY_CLUSTER
    ray_constants.ENABLE_RAY_CLUSTER = False
    try:
        yield
    finally:
        ray_constants.ENABLE_RAY_CLUSTER = before


def _lives(process: psutil.Process) -> bool:
    try:
        return bool(process.is_running() and process.status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False
